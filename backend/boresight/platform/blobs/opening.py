"""Opening the files of an installation wherever they are kept: folder and bucket know nothing of each other's choice."""

from __future__ import annotations

from pathlib import Path

from boresight.errors import RefusedInputError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.store import BlobStore


def open_blobs(place: BlobLocation, *, make: bool = True) -> BlobStore:
    """Open the files at a place; those of an object store are opened once a process."""
    if place.is_folder:
        blobs = FolderBlobStore(Path(place.address))
        if not make:
            blobs.open(make=False)
        return blobs
    try:
        from boresight.platform.blobs.bucket import open_bucket  # noqa: PLC0415 - an optional part
    except ImportError as error:
        raise RefusedInputError("An object store needs its library: pip install 'boresight[object-store]'.") from error
    return open_bucket(place)
