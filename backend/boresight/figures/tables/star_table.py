"""The table of stars, worst first, as page and report print it, and the list of those to flag."""

from __future__ import annotations

from dataclasses import dataclass

from boresight.figures.chart import Result
from boresight.verdicts.numbers import count, fixed
from boresight.verdicts.verdict import read_part


@dataclass(frozen=True)
class StarRow:
    """One star: its Hipparcos number, how often it was seen, and its residual."""

    star_id: int
    sightings: int | None
    mean_px: float | None
    rms_px: float | None
    z: float | None
    suspect: bool
    flags: str

    @property
    def numbers(self) -> tuple[float | str, ...]:
        """What the columns of `cells` are sorted by; an empty word where there is no number."""
        return tuple("" if n is None else n for n in (self.sightings, self.mean_px, self.rms_px, abs(self.z or 0.0)))

    @property
    def cells(self) -> tuple[str, ...]:
        """The numbers as they are printed, after the star's own."""
        return count(self.sightings), fixed(self.mean_px, 3), fixed(self.rms_px, 3), fixed(self.z, 1)


def star_rows(result: Result) -> list[StarRow]:
    """Read the stars of a result, worst first; none where they were not examined."""
    return [
        StarRow(
            star_id=row["star_id"],
            sightings=row.get("sightings"),
            mean_px=row.get("mean_residual_px"),
            rms_px=row.get("rms_px"),
            z=row.get("z"),
            suspect=bool(row.get("suspect")),
            flags=", ".join(map(str, row.get("flags") or ())),
        )
        for row in read_part(result, "stars") or ()
    ]


def to_flag(result: Result) -> str:
    """List the suspects' Hipparcos numbers, ready to paste; empty where there are none."""
    return ", ".join(str(star) for star in (result.get("trust") or {}).get("suspects") or ())
