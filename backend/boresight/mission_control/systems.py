"""The mission control systems that an installation is linked to: where each is, and what it is asked for and given."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from typing import Final

from boresight.errors import RefusedInputError
from boresight.mission_control.archive import Archive
from boresight.mission_control.connection import Server, read_server
from boresight.mission_control.openc3 import OpenC3
from boresight.mission_control.yamcs import Yamcs

#: What each system is called, by the word that settings, rules and commands have for it.
TITLES: Final[Mapping[str, str]] = {"yamcs": "Yamcs", "openc3": "OpenC3"}
IMAGE, DEFINITION = "table.bin", "table_def.txt"


@dataclass(frozen=True)
class Link:
    """One system: its address, `part` (Yamcs: the instance, OpenC3: the scope), and `store` (the bucket, the target) for tables."""

    system: str
    url: str
    part: str
    store: str = ""
    credentials: str = field(default="", repr=False)
    authority: str = ""

    @property
    def title(self) -> str:
        """What people call it."""
        return TITLES[self.system]

    @property
    def place(self) -> str:
        """Where tables go, for people."""
        return f"{self.title} at {self.url}, {'bucket' if self.system == 'yamcs' else 'target'} {self.store}"

    def open(self) -> Archive:
        """Open the archive; nothing is sent yet."""
        return self._open_yamcs() if self.system == "yamcs" else self._open_openc3()

    def _server(self) -> Server:
        return read_server(self.title, self.url, f"BORESIGHT_{self.system.upper()}", self.credentials, self.authority)

    def _open_yamcs(self) -> Yamcs:
        if not self.part:
            raise RefusedInputError("BORESIGHT_YAMCS_INSTANCE is empty: name the instance of Yamcs.")
        return Yamcs(self._server(), self.part)

    def _open_openc3(self) -> OpenC3:
        return OpenC3(self._server(), self.part)

    def open_events(self) -> Yamcs:
        """Open the system that takes events, which is Yamcs alone."""
        return self._open_yamcs()

    def hand_over(self, name: str, sha256: str, files: Mapping[str, bytes]) -> tuple[str, ...]:
        """Store the table of a package for whoever commands, and return where each file lies; the same again changes nothing."""
        if IMAGE not in files:
            raise RefusedInputError(
                "The package has no table: give the sensor a table definition, and export it again."
            )
        if self.system == "yamcs":
            with closing(self._open_yamcs()) as yamcs:
                return (yamcs.store_object(self.store, f"{name}/{sha256[:12]}/{IMAGE}", files[IMAGE]),)
        called = re.sub(r"\W", "_", f"{name}_{sha256[:12]}", flags=re.ASCII).lower()
        with closing(self._open_openc3()) as openc3:
            return (
                openc3.store_file(f"{self.store}/tables/config/{called}_def.txt", files[DEFINITION]),
                openc3.store_file(f"{self.store}/tables/bin/{called}.bin", files[IMAGE]),
            )
