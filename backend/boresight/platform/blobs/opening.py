"""Opening the blob store of an installation, a folder or a bucket."""

from __future__ import annotations

from pathlib import Path

from boresight.errors import RefusedInputError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.store import BlobStore


def open_blobs(place: BlobLocation, *, make: bool = True) -> BlobStore:
    """Open the blob store at a location; an object store is opened once per process."""
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
