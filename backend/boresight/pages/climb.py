"""The rungs of a set's way to the spacecraft, and the files of the package that goes there, as the page shows them."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass

from boresight.pages.runs import Names
from boresight.services.history import how_known
from boresight.store.tables import Package, Uplink

LADDER = ("SENT", "LOADED", "VERIFIED", "ACTIVE")


@dataclass(frozen=True)
class Step:
    """One rung of the ladder.

    Parameters
    ----------
    name
        What it is called.
    level, word
        `normal` when it is taken, `critical` when the read-back failed there, `standby` when it is next, else `off`.
    at_utc, who, source, how
        Of the record that took it; empty before.
    """

    name: str
    level: str
    word: str
    at_utc: str | None = None
    who: str = ""
    source: str = ""
    how: str = ""


def steps_of(exported: Package | None, records: Sequence[Uplink], names: Names) -> list[Step]:
    """Lay out the present climb.

    Parameters
    ----------
    exported
        The package that the climb carries.
    records
        Everything recorded of the set, newest first.
    """
    climb = climb_of(records)
    taken = [_exported(exported, names), *(_taken(climb, state, names) for state in LADDER)]
    following = next((place for place, step in enumerate(taken) if step is None), len(taken))
    if records and records[0].onboard_state in {"MISMATCH", "UNKNOWN"}:
        following = len(taken)
    titles = ("Exported", *(state.capitalize() for state in LADDER))
    return [
        step or Step(title, "standby" if place == following else "off", "next" if place == following else "to come")
        for place, (title, step) in enumerate(zip(titles, taken, strict=True))
    ]


def climb_of(records: Sequence[Uplink]) -> Sequence[Uplink]:
    """Return what was recorded since the set was last sent, newest first."""
    sent = next((place for place, row in enumerate(records) if row.onboard_state == "SENT"), len(records) - 1)
    return records[: sent + 1]


def exported_of(packages: Sequence[Package], records: Sequence[Uplink]) -> Package | None:
    """Return the package that the present climb carries: the one that was sent, before that the newest; None where none is.

    Parameters
    ----------
    packages, records
        Of the set, newest first.
    """
    named = [(row.evidence or {}).get("package") for row in climb_of(records) if row.onboard_state == "SENT"]
    if named and named[-1] is not None:
        return next((package for package in packages if package.id == named[-1]["id"]), None)
    return packages[0] if packages else None


def _exported(package: Package | None, names: Names) -> Step | None:
    """Return the first rung, where there is a package."""
    if package is None:
        return None
    return Step(
        "Exported", "normal", "done", package.created_utc, names.person(package.created_by), f"package {package.id}"
    )


def _taken(climb: Sequence[Uplink], state: str, names: Names) -> Step | None:
    """Return a rung that was taken, or at which the read-back failed."""
    wanted = {"VERIFIED", "MISMATCH"} if state == "VERIFIED" else {state}
    row = next((row for row in climb if row.onboard_state in wanted), None)
    if row is None:
        return None
    failed = row.onboard_state == "MISMATCH"
    who = row.printed_name or names.person(row.recorded_by)
    level, word = ("critical", "MISMATCH") if failed else ("normal", "done")
    return Step(state.capitalize(), level, word, row.recorded_utc, who, row.source, how_known(row))


@dataclass(frozen=True)
class Member:
    """A file inside a package."""

    name: str
    size_bytes: int
    sha256: str


def members_of(content: bytes) -> list[Member]:
    """List the files of a package with their hashes."""
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return [
            Member(name, len(inside), hashlib.sha256(inside).hexdigest())
            for name in packed.namelist()
            for inside in (packed.read(name),)
        ]
