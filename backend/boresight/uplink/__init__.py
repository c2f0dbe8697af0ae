"""What goes to the spacecraft: camera parameters as the bytes of its table, and the package that carries them."""

from __future__ import annotations
