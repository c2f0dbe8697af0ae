"""The watched bucket: a prefix of an object store with one folder a sensor, named as it; each version of an object is taken once.

    s3://bucket/prefix/<sensor>/pass-17.csv     new: taken, and known from then on by its key and ETag

An object is there complete or not at all, so nothing has to settle. Nothing is moved, changed or deleted: the server needs no more
than the right to list and read. What was taken is a row in the database, written with its decision; an object that is replaced has
another ETag and is another file. Names are left alone as in the watched folder, and so is what lies deeper.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import obstore
from obstore.exceptions import PreconditionError
from obstore.store import ObjectStore

from boresight.console.ingest.folder import UNDER_WAY, TakenFile, refuse_too_large
from boresight.errors import RefusedInputError, UnavailableError
from boresight.platform.blobs.bucket import asking, connect

MOST_OBJECTS = 100_000  # of a sensor: a hundred requests a look


@dataclass(frozen=True)
class ArrivedObject:
    """A version of an object in a sensor's folder of the bucket."""

    sensor: str
    name: str
    address: str
    version: str
    size_bytes: int

    @property
    def key(self) -> tuple[str, str]:
        """What it is known by once it was taken: its address and ETag."""
        return self.address, self.version


class WatchedBucket:
    """The watched bucket, which is listed every `every_s` seconds and remembers what was dealt with."""

    def __init__(
        self,
        address: str,
        every_s: float,
        store: ObjectStore | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.address = address
        self._store = connect(address) if store is None else store
        self._every_s = every_s
        self._clock = clock
        self._due_s = clock()
        self._known: set[tuple[str, str]] = set()
        self._waiting: dict[str, int] = {}

    def list_new(self, sensors: list[str]) -> list[ArrivedObject]:
        """Return the objects of some sensors that are not known yet, oldest first; nothing before the next look is due."""
        if self._clock() < self._due_s:
            return []
        self._due_s = self._clock() + self._every_s
        try:
            found = [one for sensor in sensors for one in self._look_into(sensor)]
        except (
            UnavailableError
        ) as error:  # a store tells a bucket that is not there from a network that fails in its message alone
            raise UnavailableError(
                f"The watched bucket {self.address} cannot be listed: create the bucket, or correct BORESIGHT_WATCH_BUCKET "
                "or the network connection."
            ) from error
        self._waiting = {sensor: sum(one.sensor == sensor for _, one in found) for sensor in sensors}
        return [one for _, one in sorted(found, key=lambda pair: (pair[0], pair[1].address))]

    def _look_into(self, sensor: str) -> Iterator[tuple[str, ArrivedObject]]:
        count, folder = 0, f"{sensor}/"
        with asking(self.address, self._missing):
            for listed in obstore.list(self._store, prefix=folder, chunk_size=1000):
                count += len(listed)
                if count > MOST_OBJECTS:
                    raise RefusedInputError(
                        f"{self.address}/{folder} has more than {MOST_OBJECTS:,} objects: move older ones elsewhere."
                    )
                for one in listed:
                    name = one["path"].removeprefix(folder)
                    if "/" in name or name.startswith(".") or name.lower().endswith(UNDER_WAY):
                        continue
                    arrived = ArrivedObject(
                        sensor, name, f"{self.address}/{one['path']}", one["e_tag"] or "*", one["size"]
                    )
                    if arrived.key not in self._known:
                        yield one["last_modified"].isoformat(), arrived

    @property
    def _missing(self) -> str:
        return f"There is no bucket for {self.address}; make it, or correct BORESIGHT_WATCH_BUCKET."

    def look_again(self) -> None:
        """Make the next look due at once: not all of the last one was dealt with."""
        self._due_s = self._clock()

    def count_waiting(self, sensor: str) -> int:
        """Count the objects of a sensor that were not taken yet, as of the last look."""
        return self._waiting.get(sensor, 0)

    def note_known(self, arrived: ArrivedObject) -> None:
        """Remember that an object was dealt with."""
        if arrived.key not in self._known:
            self._known.add(arrived.key)
            self._waiting[arrived.sensor] = max(0, self._waiting.get(arrived.sensor, 0) - 1)

    def take(self, arrived: ArrivedObject, into: Path, most_bytes: int) -> TakenFile | None:
        """Copy an object, or return None where it is another since, gone or dealt with; refuse one that is too large."""
        if arrived.key in self._known:
            return None
        refuse_too_large(arrived.name, arrived.size_bytes, most_bytes)
        digest, size = hashlib.sha256(), 0
        key = arrived.address.removeprefix(f"{self.address}/")
        with asking(self.address, self._missing):
            try:
                answer = obstore.get(self._store, key, options={"if_match": arrived.version})
            except (FileNotFoundError, PreconditionError):
                return None
            with into.open("xb") as copy:
                for chunk in answer.stream():
                    size += len(chunk)
                    refuse_too_large(arrived.name, size, most_bytes)
                    digest.update(chunk)
                    copy.write(chunk)
        return TakenFile(into, arrived.name, digest.hexdigest(), size)
