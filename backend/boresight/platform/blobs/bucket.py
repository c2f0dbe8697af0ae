"""Blobs in a bucket of an object store, named as in the folder: `prefix/ab/cd/abcd...`.

An object is put once and never changed, so what was fetched stays right forever. A file is fetched once a machine, into
a folder in the layout of `FolderBlobStore`: written beside while its SHA-256 is taken, and named only when that is the address,
so it is there complete and right or not at all. What was asked for longest ago is let go when more lies there than
allowed, but nothing that was asked for within the last hour: it may be about to be opened. Who has it open keeps it. A
file here that is not what it was when it was fetched is fetched again.

The store checks what is put: requests are signed together with the SHA-256 of their body, and the size is asked for
after. Credentials come from the environment of each process as the store's own programs read them (AWS_ACCESS_KEY_ID,
AWS_ENDPOINT_URL, GOOGLE_APPLICATION_CREDENTIALS, AZURE_STORAGE_ACCOUNT_KEY ...), so they pass through no address, log or task.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import timedelta
from functools import cache
from pathlib import Path

import obstore
from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError
from obstore.store import ObjectStore, from_url

from boresight import disks as integrity
from boresight.errors import CorruptFileError, ForbiddenError, NotFoundError, UnavailableError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.store import CHUNK_BYTES, BlobStore, open_content, written_beside

KEPT_S = 3600.0  # after its last use
MARK_S = KEPT_S / 12  # a file used again within this time is not marked again
LOOK_AFTER = 20  # the folder is measured after a twentieth of what it may hold was added
ANSWERS_WITHIN, ENDS_WITHIN, TRIED_FOR, LOOKS_FOR = (timedelta(seconds=number) for number in (5, 60, 20, 2))
LOOKED_FOR = "is-it-there"


class BucketBlobStore(BlobStore):
    """The blobs of a bucket; `folder` caches what was fetched or stored recently."""

    def __init__(self, place: BlobLocation, store: ObjectStore, looking: ObjectStore | None = None) -> None:
        super().__init__(place.cache_folder)
        self.kept_at = self.address = place.address
        self.limit_bytes = place.cache_bytes
        self._here = FolderBlobStore(place.cache_folder, is_cache=True)
        self._store = store
        self._looking = looking or store  # the same with short timeouts
        self._added_bytes = self.limit_bytes  # measured at the first use

    def open(self, *, make: bool = True) -> None:
        """Open the cache folder."""
        self._here.open(make=make)

    def put(self, content: bytes | Path) -> str:
        """Store bytes, or a copy of a file, in bucket and cache, and return their address."""
        with (
            open_content(content) as source,
            self._here.writing(),
            written_beside(source, self.folder) as (written, sha256),
        ):
            size = written.stat().st_size
            with self._asking(
                f"There is no bucket for {self.address}; make it, or correct the address in BORESIGHT_BLOBS."
            ):
                if self._get_size(sha256) != size:
                    obstore.put(self._store, _key(sha256), written)
                    if self._get_size(sha256) != size:
                        raise UnavailableError(
                            f"The file {sha256[:12]} did not arrive completely in {self.address}; try again, and check the store."
                        )
            self._keep_here(written, sha256, size)
        return sha256

    def send_ahead(self, *files: Path) -> None:
        """Send files to the bucket in advance, so that `put` sends nothing."""
        for file in files:
            self.put(file)

    def discard(self, sha256: str) -> None:
        """Remove the cached copy; an object that no row names is harmless."""
        self._here.discard(sha256)

    def remove(self, sha256: str) -> None:
        """Remove a file on purpose, here and in the bucket."""
        self._here.remove(sha256)
        with self._asking(""), suppress(FileNotFoundError):
            obstore.delete(self._store, _key(sha256))

    def refuse_unusable(self) -> None:
        """Check that the bucket answers, by asking for an object that does not exist."""
        self._here.refuse_unusable()
        with self._asking(""), suppress(FileNotFoundError):
            obstore.head(self._looking, LOOKED_FOR)

    def _get_size(self, sha256: str) -> int | None:
        """Return the size of an object, None where there is none."""
        try:
            return obstore.head(self._store, _key(sha256))["size"]
        except FileNotFoundError:
            return None

    def path(self, sha256: str) -> Path:
        """Return a read-only file with the bytes of an address, fetched the first time."""
        place = self._here.locate(sha256)
        try:
            if not integrity.is_intact(place, sha256):
                place.unlink(missing_ok=True)
            elif time.time() - (found := place.stat()).st_atime > MARK_S:
                os.utime(place, ns=(time.time_ns(), found.st_mtime_ns))
        except FileNotFoundError:
            pass
        if not place.exists():
            self._fetch(sha256)
        return place

    def check(self, sha256: str, *, again: bool) -> int:
        """Check an object against its address and return its size.

        Reading it in full has its price at the store; otherwise only its size is read, and the cached copy is checked when it is
        used.
        """
        if not again:
            return self.size(sha256)
        digest, size = hashlib.sha256(), 0
        for chunk in self._streamed(sha256):
            digest.update(chunk)
            size += len(chunk)
        self._refuse_other(digest.hexdigest(), sha256)
        return size

    def size(self, sha256: str) -> int:
        """Return the size of an address's object."""
        with self._asking(self._missing(sha256)):
            return obstore.head(self._store, _key(sha256))["size"]

    def _missing(self, sha256: str) -> str:
        return f"The stored file {sha256[:12]} is missing from {self.address}; restore it there from a backup."

    def _streamed(self, sha256: str) -> Iterator[bytes]:
        """Yield the bytes of an object piece by piece."""
        with self._asking(self._missing(sha256)):
            for chunk in obstore.get(self._store, _key(sha256)).stream(min_chunk_size=CHUNK_BYTES):
                yield bytes(chunk)

    def _refuse_other(self, found: str, sha256: str) -> None:
        """Refuse bytes that are not those of the address."""
        if found != sha256:
            self.tell_corrupt(sha256)
            raise CorruptFileError(
                f"The stored file {sha256[:12]} was altered in {self.address}; restore its previous version there.",
                sha256,
                code="altered-file",
            )

    def _fetch(self, sha256: str) -> None:
        """Fetch an object into the cache, complete and verified or not at all."""
        self.refuse_removed(sha256)
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        digest = hashlib.sha256()
        with tempfile.TemporaryDirectory(prefix=".get-", dir=self.folder) as folder:
            written = Path(folder) / sha256
            with written.open("wb") as file:
                for chunk in self._streamed(sha256):
                    digest.update(chunk)
                    file.write(chunk)
            self._refuse_other(digest.hexdigest(), sha256)
            self._keep_here(written, sha256, written.stat().st_size)

    def _keep_here(self, written: Path, sha256: str, size: int) -> None:
        """Move a complete file into the cache, and remove others when it holds too much."""
        self._here.keep(written, sha256)
        self._added_bytes += size
        if self._added_bytes > self.limit_bytes // LOOK_AFTER:
            self._added_bytes = 0
            self._make_room()

    def _make_room(self) -> None:
        """Remove the least recently used files until the limit holds."""
        found = sorted(_files(self.folder))
        too_much = sum(size for _, size, _ in found) - self.limit_bytes
        for asked_s, size, path in found:
            if too_much <= 0 or time.time() - asked_s < KEPT_S:
                return
            path.unlink(missing_ok=True)
            too_much -= size

    def _asking(self, missing: str) -> AbstractContextManager[None]:
        return asking(self.address, missing)


@contextmanager
def asking(address: str, missing: str) -> Iterator[None]:
    """Turn an object store's errors into one sentence, without its message, which may contain addresses and headers."""
    try:
        yield
    except FileNotFoundError as error:
        raise NotFoundError(missing, code="not-in-store") from error
    except (PermissionDeniedError, UnauthenticatedError) as error:
        raise ForbiddenError(
            f"The object store denied access to {address} with the credentials of this process; "
            "check the key and its permissions."
        ) from error
    except BaseError as error:
        raise UnavailableError(
            f"The object store at {address} does not answer; check its address and the network, and try again.",
            code="store-unreachable",
        ) from error


def _key(sha256: str) -> str:
    """Return the object's key, the same as the path in a folder of blobs, so that files can be copied between both."""
    return f"{sha256[:2]}/{sha256[2:4]}/{sha256}"


def _files(folder: Path) -> Iterator[tuple[float, int, Path]]:
    """Yield each cached file with its last use and size, without those that are removed meanwhile."""
    for path in folder.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*"):
        try:
            found = path.stat()
        except FileNotFoundError:
            continue
        yield found.st_atime, found.st_size, path


@cache
def open_bucket(place: BlobLocation) -> BucketBlobStore:
    """Open a bucket, once per process, because its connections are kept."""
    looking = from_url(
        place.address,
        client_options={"allow_http": True, "connect_timeout": LOOKS_FOR, "timeout": LOOKS_FOR},
        retry_config={"max_retries": 0, "retry_timeout": LOOKS_FOR},
    )
    return BucketBlobStore(place, connect(place.address), looking)


def connect(address: str) -> ObjectStore:
    """Return the client of a place in an object store, with the credentials of the environment."""
    return from_url(  # an endpoint without TLS is used only where the environment names one
        address,
        client_options={"allow_http": True, "connect_timeout": ANSWERS_WITHIN, "timeout": ENDS_WITHIN},
        retry_config={"max_retries": 4, "retry_timeout": TRIED_FOR},
    )
