"""What an image is called and how much it may hold: known to commands and settings without anything that reads images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

#: What an image is called, by what it is then read as.
SUFFIXES: Final = {
    ".fits": "FITS", ".fit": "FITS", ".fts": "FITS", ".fz": "FITS", ".gz": "FITS",
    ".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF",
    ".raw": "raw", ".bin": "raw", ".dat": "raw",
}  # fmt: skip
#: What is told before it is read that it is no image that can be.
FOREIGN_SUFFIXES: Final = (".jpg", ".jpeg", ".bmp", ".gif", ".cr2", ".nef")


def is_image(path: Path) -> bool:
    """Whether a file's name is an image's; what is compressed by gzip is one unless the name inside is another's."""
    suffix = path.suffix.lower()
    inside = Path(path.stem).suffix.lower() if suffix == ".gz" else ""
    return suffix in {*SUFFIXES, *FOREIGN_SUFFIXES} and (not inside or SUFFIXES.get(inside) == "FITS")


def is_archive(path: Path) -> bool:
    """Whether a file is a ZIP."""
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04"


@dataclass(frozen=True)
class ImageSource:
    """Where an image is, and what its sender called it."""

    path: Path
    name: str


@dataclass(frozen=True)
class ImageLimits:
    """How much images may hold: files of a set, bytes of a file, pixels of an image."""

    images: int = 2000
    file_bytes: int = 512_000_000
    pixels: int = 150_000_000


LIMITS = ImageLimits()
