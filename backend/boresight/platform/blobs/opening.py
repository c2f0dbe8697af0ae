"""Opening the files of an installation wherever they are kept: folder and bucket know nothing of each other's choice."""

from __future__ import annotations

from pathlib import Path

from boresight.errors import RefusedInputError
from boresight.platform.blobs.folder import BlobStore
from boresight.platform.blobs.locations import BlobLocation


def open_blobs(place: BlobLocation, *, make: bool = True) -> BlobStore:
    """Open the files at a place; those of an object store are opened once a process."""
    if place.is_folder:
        blobs = BlobStore(Path(place.address))
        if not make:
            blobs.open(make=False)
        return blobs
    try:
        from boresight.platform.blobs.bucket import open_object_blobs  # noqa: PLC0415 - an optional part
    except ImportError as error:
        raise RefusedInputError("An object store needs its library: pip install 'boresight[object-store]'.") from error
    return open_object_blobs(place)
