"""Which parameters of an archive a mapping profile wants: the columns that it names.

Parameters must be named in full, as the archive knows them: `/TRK/STAR1_ROW` of Yamcs, `TRK STARS STAR1_ROW` of OpenC3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from boresight.errors import RefusedInputError
from boresight.telemetry.imports.profile import Profile

NAMED = 3  # that a sentence names


@dataclass(frozen=True)
class WantedColumns:
    """The names that a profile's columns have in the archive, in its order, and those that must be there."""

    names: tuple[str, ...]
    required: frozenset[str]

    def choose(self, known: frozenset[str], system: str) -> tuple[str, ...]:
        """Return the names that the archive has; refuse where one is missing that the profile cannot do without."""
        if missing := [name for name in self.names if name in self.required and name not in known]:
            more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
            raise RefusedInputError(
                f"{system} has no {', '.join(missing[:NAMED])}{more}; correct the names in the mapping profile."
            )
        return tuple(name for name in self.names if name in known)


def list_wanted(profile: Profile, is_full: Callable[[str], bool], example: str, times: frozenset[str]) -> WantedColumns:
    """Return the columns of a profile, without those of the archive's own `times`."""
    found: dict[str, bool] = {}
    for column, required in _list_columns(profile):
        for number, name in enumerate(_expand(column, profile)):
            first = name.partition("|")[0]
            found[first] = found.get(first, False) or (required and number == 0)
    names = tuple(name for name in found if name not in times)
    if short := [name for name in names if not is_full(name)]:
        raise RefusedInputError(
            f"The mapping profile {profile.name} names {short[0]!r}, which is not a full parameter name; write it like {example}."
        )
    return WantedColumns(names, frozenset(name for name in names if found[name]))


def _list_columns(profile: Profile) -> Iterator[tuple[str, bool]]:
    """Yield every column that a profile names, and whether it is needed."""
    parts: Mapping[str, Sequence[str | None]] = {
        "row": _take(profile.row, "column"),
        "col": _take(profile.col, "column"),
        "frames": (profile.frames.column, profile.frames.exposure, *profile.layout.where),
        "wide": _take(profile.wide, "count_column"),
        "time": _take(profile.time, "column", "week_column"),
        "star_id": _take(profile.star_id, "column"),
        "directions": _take(profile.directions, "ra", "dec"),
        "quaternion": () if profile.quaternion is None else profile.quaternion.columns,
        "velocity": () if profile.velocity is None else profile.velocity.columns,
        "magnitude": _take(profile.magnitude, "column"),
        "sigma": () if profile.sigma is None else profile.sigma.columns,
        "temperature": _take(profile.temperature, "column"),
    }
    for part, columns in parts.items():
        yield from ((column, part not in profile.optional) for column in columns if column is not None)
    if profile.keep != "all":
        yield from ((column, False) for column in profile.keep)


def _take(part: object | None, *names: str) -> Sequence[str | None]:
    return () if part is None else [getattr(part, name) for name in names]


def _expand(column: str, profile: Profile) -> Iterator[str]:
    """Yield a column's name, or that of each star where they stand beside one another."""
    if "{n}" not in column or profile.wide is None:
        yield column
        return
    for number in range(profile.wide.first, profile.wide.first + profile.wide.count):
        yield column.replace("{n}", str(number))
