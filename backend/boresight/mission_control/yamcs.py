"""Yamcs over its HTTP API: parameters of the archive, events, and objects of a bucket.

An export asks `/archive/{instance}:exportParameterValues`, one row for each generation time. Its header has full or short names
as the version goes, always in the order that was asked for, so the names that were asked for are written instead. Yamcs keeps
milliseconds; what it sends outside of the range is left out. An event sent twice (time, source, sequence number) is one event.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final
from urllib.parse import quote

from boresight.errors import UnavailableError
from boresight.mission_control.archive import (
    MOST_EXPORT_BYTES,
    ArchiveRows,
    make_rows,
    read_time_us,
    write_time,
)
from boresight.mission_control.columns import list_wanted
from boresight.mission_control.connection import Connection, Server
from boresight.telemetry.imports.profile import Profile

TIME: Final = "Time"
EXAMPLE: Final = "/TRK/STAR1_ROW"
SOURCE: Final = "Boresight"
PAGE: Final = 1000
MOST_PARAMETERS: Final = 100_000
LONGEST_QUERY: Final = 4000  # characters that every version takes in an address


@dataclass(frozen=True)
class YamcsEvent:
    """An event; `number` with its time makes it the same event when it is sent again."""

    at_utc: str
    number: int
    kind: str
    severity: str
    message: str
    extra: Mapping[str, str] = field(default_factory=dict)


class Yamcs:
    """One instance of a Yamcs server."""

    suffix = ".tsv"

    def __init__(self, server: Server, instance: str) -> None:
        self.instance = instance
        self._connection = Connection(server)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def export(self, profile: Profile, start_us: int, stop_us: int) -> ArchiveRows:
        """Return the rows of the parameters that a profile names, from start to before stop."""
        wanted = list_wanted(profile, lambda name: name.startswith("/"), EXAMPLE, frozenset({TIME}))
        known = self.list_parameters({name.rpartition("/")[0] or "/" for name in wanted.names})
        names = wanted.choose(known, f"The instance {self.instance} of Yamcs")
        asked = {"start": write_time(start_us), "stop": write_time(stop_us)}
        query: list[tuple[str, str]] = [("parameters", name) for name in names]
        path = f"/api/archive/{quote(self.instance, safe='')}:exportParameterValues"
        if sum(len(name) for _, name in query) < LONGEST_QUERY:
            given: dict[str, Any] = {"params": [*query, *asked.items()]}
            content = self._ask("GET", path, most_bytes=MOST_EXPORT_BYTES, **given)
        else:
            given = {"json": {"parameters": list(names), **asked}}
            content = self._ask("POST", path, most_bytes=MOST_EXPORT_BYTES, **given)
        return make_rows("\t".join((TIME, *names)), _read_rows(content, len(names)), start_us, stop_us)

    def list_parameters(self, systems: Iterable[str]) -> frozenset[str]:
        """Return the full names of the parameters in some space systems."""
        path, found = f"/api/mdb/{quote(self.instance, safe='')}/parameters", set[str]()
        for system in sorted(systems):
            following: dict[str, str] = {}
            while len(found) < MOST_PARAMETERS:
                asked = {"system": system, "limit": str(PAGE), **following}
                document = self._document("GET", path, params=asked)
                found |= {one["qualifiedName"] for one in document.get("parameters", ())}
                if not (token := document.get("continuationToken")):
                    break
                following = {"next": token}
        return frozenset(found)

    def post_event(self, event: YamcsEvent) -> None:
        """Put an event into the archive and before whoever watches."""
        body = {
            "message": event.message,
            "type": event.kind,
            "severity": event.severity,
            "time": event.at_utc,
            "source": SOURCE,
            "sequenceNumber": event.number,
            "extra": dict(event.extra),
        }
        self._ask("POST", f"/api/archive/{quote(self.instance, safe='')}/events", json=body)

    def store_object(self, bucket: str, name: str, content: bytes) -> str:
        """Put an object into a bucket, read it back to see that it is whole, and return its address."""
        path = f"/api/storage/buckets/{quote(bucket, safe='')}/objects/{quote(name)}"
        self._ask("POST", path, content=content, headers={"Content-Type": "application/octet-stream"})
        if self._ask("GET", path, most_bytes=len(content) + 1) != content:
            raise UnavailableError(
                f"The object {name} in the bucket {bucket} of Yamcs is not what was sent; send it again."
            )
        return f"{bucket}/{name}"

    @cached_property
    def _admission(self) -> dict[str, str]:
        """The headers that let us in: a token for name and password, or a key."""
        server = self._connection.server
        if not server.secret:
            return {}
        if server.account is None:
            return {"x-api-key": server.secret}
        name, password = server.account
        form = {"grant_type": "password", "username": name, "password": password}
        document = self._connection.ask_document("POST", "/auth/token", data=form)
        if not isinstance(document, Mapping) or not isinstance(document.get("access_token"), str):
            raise UnavailableError(
                f"Yamcs at {server.url} gave no token for the credentials; check {server.setting}_URL."
            )
        return {"Authorization": f"Bearer {document['access_token']}"}

    def _ask(self, method: str, path: str, **given: Any) -> bytes:
        given["headers"] = {**given.pop("headers", {}), **self._admission}
        return self._connection.ask(method, path, **given)

    def _document(self, method: str, path: str, **given: Any) -> Mapping[str, Any]:
        return self._connection.ask_mapping(method, path, headers=self._admission, **given)


def _read_rows(content: bytes, columns: int) -> Sequence[tuple[int, str]]:
    """Read an export, whose first line has the names; a row that is cut off is an export that is."""
    lines = csv.reader(io.StringIO(content.decode("utf-8", "replace")), delimiter="\t")
    next(lines, None)
    found = []
    for cells in lines:
        if len(cells) != columns + 1:
            raise UnavailableError(
                f"Yamcs exported a row of {len(cells)} cells where {columns + 1} were asked for; check its version."
            )
        if any("\t" in cell or "\n" in cell or '"' in cell for cell in cells):
            raise UnavailableError(
                "Yamcs exported text that contains tabs, line breaks or quotes; remove that parameter from the mapping profile."
            )
        found.append((read_time_us(cells[0], "Yamcs"), "\t".join(cells)))
    return found
