"""`python -m boresight` is the command `boresight`."""

from __future__ import annotations

from boresight.cli import main

if __name__ == "__main__":
    main(prog_name="boresight")
