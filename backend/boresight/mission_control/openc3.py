"""OpenC3 COSMOS over its HTTP API: decommutated items of its history by JSON-RPC, and files of a target.

`get_tlm_values` with `start_time` and `end_time` answers from the time-series database: a row for each packet between them, each
item as [value, limits state], and one row alone without its outer list. Items of several packets would be joined there and
repeated, so each packet is asked for by itself, and its rows stand apart, as packets do. Files go to `targets_modified` of the
configuration bucket by an address that the server signs, where Table Manager finds them.
"""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Final
from urllib.parse import quote, urlsplit

import orjson

from boresight.errors import RefusedInputError, UnavailableError
from boresight.mission_control.archive import (
    MOST_EXPORT_BYTES,
    ArchiveRows,
    make_rows,
    read_time_us,
    write_time,
)
from boresight.mission_control.columns import list_wanted
from boresight.mission_control.connection import HEARD, Connection, Server
from boresight.telemetry.imports.profile import Profile

TIME: Final = "TIME"
EXAMPLE: Final = "'TRK STARS STAR1_ROW'"
PARTS: Final = 3  # target, packet, item
BUCKET: Final = "OPENC3_CONFIG_BUCKET"


class OpenC3:
    """One scope of an OpenC3 COSMOS server."""

    suffix = ".csv"

    def __init__(self, server: Server, scope: str) -> None:
        self.scope = scope
        self._connection = Connection(server)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def export(self, profile: Profile, start_us: int, stop_us: int) -> ArchiveRows:
        """Return the packets with the items that a profile names, from start to before stop."""
        wanted = list_wanted(profile, lambda name: len(name.split()) == PARTS, EXAMPLE, frozenset({TIME}))
        known = self._find_items(wanted.names)
        names = wanted.choose(frozenset(known), "OpenC3")
        packets: dict[str, list[str]] = {}
        for name in names:
            packets.setdefault(" ".join(name.split()[:2]), []).append(name)
        found = [
            (at_us, line)
            for packet, own in packets.items()
            for at_us, line in self._read_packet(packet, own, names, known, start_us, stop_us)
        ]
        return make_rows(_write_line((TIME, *names)), found, start_us, stop_us)

    def _find_items(self, names: Sequence[str]) -> dict[str, str]:
        """Return the items that exist, each as `get_tlm_values` wants it named."""
        asked = ["__".join((*name.upper().split(), "CONVERTED")) for name in names]
        answer = self._call("get_tlm_available", asked)
        if not isinstance(answer, list) or len(answer) != len(names):
            raise UnavailableError("OpenC3 did not say which items it has; check its version, 7 or later.")
        return {
            name: str(item).removesuffix("__LIMITS")
            for name, item in zip(names, answer, strict=True)
            if item is not None
        }

    def _read_packet(
        self,
        packet: str,
        own: Sequence[str],
        names: Sequence[str],
        known: Mapping[str, str],
        start_us: int,
        stop_us: int,
    ) -> Iterator[tuple[int, str]]:
        """Yield time and line of each packet of one kind."""
        clock = "__".join((*packet.upper().split(), "PACKET_TIMEFORMATTED", "RAW"))
        items = [clock, *(known[name] for name in own)]
        rows = self._call("get_tlm_values", items, start_time=write_time(start_us), end_time=write_time(stop_us))
        for row in _list_rows(rows, len(items)):
            at = str(row[0][0])
            values = dict(zip(own, (pair[0] for pair in row[1:]), strict=True))
            cells = ("" if values.get(name) is None else str(values[name]) for name in names)
            yield read_time_us(at, "OpenC3"), _write_line((at, *cells))

    def store_file(self, path: str, content: bytes) -> str:
        """Put a file into a target's modified files, read it back to see that it is whole, and return its address."""
        place = f"{self.scope}/targets_modified/{path}"
        asked = {"bucket": BUCKET, "scope": self.scope}
        signed = self._document("GET", f"/openc3-api/storage/upload/{quote(place)}", params=asked)
        address = str(signed.get("url", ""))
        if not address.startswith("/") or urlsplit(address).netloc:
            raise UnavailableError("OpenC3 wants the file on another server; upload it in Table Manager instead.")
        self._connection.ask("PUT", address, content=content)
        answer = self._document("GET", f"/openc3-api/storage/download_file/{quote(place)}", params=asked)
        try:
            kept = base64.b64decode(str(answer.get("contents", "")))
        except ValueError:
            kept = b""
        if kept != content:
            raise UnavailableError(f"The file {place} of OpenC3 is not what was sent; send it again.")
        return place

    @cached_property
    def _admission(self) -> dict[str, str]:
        """The header that lets us in: a token for the password."""
        server = self._connection.server
        if not server.secret:
            return {}
        if server.account is not None:
            raise RefusedInputError(
                f"The file of {server.setting}_CREDENTIALS has a name and a password: write the password of OpenC3 alone."
            )
        token = self._connection.ask("POST", "/openc3-api/auth/verify", json={"password": server.secret})
        text = token.decode("utf-8", "replace").strip()
        if not text or not text.isprintable() or " " in text:
            raise UnavailableError(
                f"OpenC3 at {server.url} gave no token for the password; check {server.setting}_URL."
            )
        return {"Authorization": text}

    def _call(self, method: str, *params: Any, **named: Any) -> Any:
        """Call a method by JSON-RPC."""
        body = {"jsonrpc": "2.0", "method": method, "params": params, "id": 1}
        sent = orjson.dumps({**body, "keyword_params": {"scope": self.scope, **named}})
        headers = {"Content-Type": "application/json-rpc", **self._admission}
        answer = self._connection.ask_document(
            "POST", "/openc3-api/api", content=sent, headers=headers, most_bytes=MOST_EXPORT_BYTES
        )
        if not isinstance(answer, Mapping) or "result" not in answer:
            fault = answer.get("error") if isinstance(answer, Mapping) else None
            said = str(fault.get("message", "")) if isinstance(fault, Mapping) else ""
            raise RefusedInputError(
                f"OpenC3 refused {method} ({' '.join(said.split())[:HEARD] or 'no reason given'}): correct the names of the items."
            )
        return answer["result"]

    def _document(self, method: str, path: str, **given: Any) -> Mapping[str, Any]:
        return self._connection.ask_mapping(method, path, headers=self._admission, **given)


def _list_rows(result: Any, columns: int) -> Sequence[Sequence[Sequence[Any]]]:
    """Return the rows of a lookup: none, one without its outer list, or several."""
    if not result:
        return ()
    rows = result if isinstance(result, list) and isinstance(result[0], list) and _is_pair(result[0][0]) else [result]
    for row in rows:
        if not isinstance(row, list) or len(row) != columns or not all(_is_pair(pair) for pair in row):
            raise UnavailableError("OpenC3 returned rows in a format that differs from version 7; check its version.")
    return rows


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2


def _write_line(cells: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(cells)
    return text.getvalue()
