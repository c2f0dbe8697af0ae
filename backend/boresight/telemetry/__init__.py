"""What comes down from the spacecraft and what describes its sensors: schemas, readers, quality."""

from __future__ import annotations
