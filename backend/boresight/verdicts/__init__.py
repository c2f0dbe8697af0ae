"""What a number means, said once: how it is written, the verdict on a run, the gates of a parameter set."""

from __future__ import annotations
