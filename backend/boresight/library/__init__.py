"""The library: what `import boresight` offers. Every name is loaded when it is first asked for; `docs/library.md` lists them."""

from __future__ import annotations
