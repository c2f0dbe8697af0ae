"""Where the files that are not Python are found: in the wheel beside the package, in a checkout at its top."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def folder(name: str) -> Path:
    """Return the folder `frontend`, `migrations`, `docs` or the built `documentation`, from the installed wheel or the checkout."""
    top = _PACKAGE.parents[1]
    for candidate in (_PACKAGE / name, top / name, top / "build" / name):
        if candidate.is_dir():
            return candidate
    raise FileNotFoundError(
        f"Expected the folder {name!r} inside the package, or at the top or in build of the checkout"
    )
