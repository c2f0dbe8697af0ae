"""Where blobs are stored: a folder, or a bucket with a local cache folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from boresight.errors import RefusedInputError

SCHEMES = ("s3", "gs", "az", "abfs", "memory")


@dataclass(frozen=True)
class BlobLocation:
    """The address of a blob store, and a machine's cache folder for it."""

    address: str
    cache_folder: Path
    cache_bytes: int

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder, which every worker's machine must see under the same path."""
        return "://" not in self.address


def parse_address(text: str, what: str = "BORESIGHT_BLOBS") -> str:
    """Return an address of files in one spelling: an absolute path, or the URL."""
    if "://" not in text:
        return str(Path(text).expanduser().resolve())
    parts = urlsplit(text)
    if parts.scheme not in SCHEMES or not (parts.netloc or parts.scheme == "memory"):
        raise RefusedInputError(
            f"{what} names no place for files: give a folder, or an address such as {SCHEMES[0]}://bucket/prefix."
        )
    if "@" in parts.netloc or parts.query or parts.fragment:
        raise RefusedInputError(
            f"{what} must not contain credentials: give s3://bucket/prefix alone, and the key by the environment "
            "variables of the store, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY."
        )
    return text.rstrip("/")
