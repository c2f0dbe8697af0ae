"""The part of a large set that fits into memory: whole blocks of its frames, evenly spread, the first and the last among them.

Pictures of residuals, the trust tab, the shadow and the alignment need every star of what they judge at once. Three hundred
thousand stars tell a residual's mean over a cell of the detector to a hundredth of a pixel; more would change no picture.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.calibration.matching.matched_frames import GivenMatches
from boresight.calibration.matching.rematch import Matches, joined_matches, matched_telemetry
from boresight.estimation.blocks import FRAMES
from boresight.estimation.stored_arcs import Arcs
from boresight.telemetry.schema import Telemetry, joined, select_rows

#: Stars up to which a set is judged whole, and of a larger one so many are.
JUDGED_WHOLE = 500_000
JUDGED_STARS = 300_000
#: Arrays of `Matches` with an entry a row; the others have one an exposure.
OF_ROWS = ("star_id", "s_i", "row_reason", "tolerance_rad", "flags")


def spread_blocks(n_blocks: int, most: int) -> NDArray[np.int64]:
    """Places of at most so many of the blocks, evenly spread; at least one."""
    return np.unique(np.linspace(0, n_blocks - 1, max(1, min(most, n_blocks))).round().astype(np.int64))


Ends = Sequence[tuple[int, int]]
#: One stretch from the first frame to the last.
WHOLE: Ends = ((np.iinfo(np.int64).min, np.iinfo(np.int64).max),)


@dataclass(frozen=True)
class MatchedRows:
    """Rows of a set, their matches, and the stars that were kept of these, (n_rows,)."""

    telemetry: Telemetry
    matches: Matches | GivenMatches
    kept: IntArray

    def named(self) -> Telemetry:
        """The rows with the stars that were kept, and their directions."""
        if isinstance(self.matches, GivenMatches):
            return self.telemetry
        s_i = np.where(self.kept[:, None] > 0, self.matches.s_i, np.nan)
        return matched_telemetry(self.telemetry, replace(self.matches, star_id=self.kept, s_i=s_i))


def judged_frames(arcs: Arcs) -> Ends:
    """First and last frame number of each stretch of a set that is judged: all of it, or evenly spread blocks of a large one."""
    if arcs.n_stars <= JUDGED_WHOLE:
        return WHOLE
    n_blocks = -(-arcs.n_frames // FRAMES)
    chosen = spread_blocks(n_blocks, JUDGED_STARS * n_blocks // arcs.n_stars)
    return [_ends(arcs, int(block)) for block in chosen]


def judged_telemetry(parts: Iterable[Telemetry], ends: Ends) -> Telemetry:
    """Rows of the frames in these stretches, also of those that take no part; `parts` are whole frames of the set as it came."""
    return joined([select_rows(part, rows) for part in parts for rows in _rows_of_frames(part, ends)])


def judged_matches(parts: Iterable[MatchedRows], ends: Ends) -> MatchedRows:
    """The same with the matches of these rows."""
    found = [
        (select_rows(part.telemetry, rows), _matches_of_rows(part.matches, rows), part.kept[rows])
        for part in parts
        for rows in _rows_of_frames(part.telemetry, ends)
        if isinstance(part.matches, Matches)
    ]
    telemetry, matches, kept = zip(*found, strict=True)
    return MatchedRows(joined(telemetry), joined_matches(matches), np.concatenate(kept))


def _ends(arcs: Arcs, block: int) -> tuple[int, int]:
    """First and last frame number of a block."""
    places = block * FRAMES, min((block + 1) * FRAMES, arcs.n_frames) - 1
    first, last = (int(arcs.frames(place, place + 1).frame[0]) for place in places)
    return first, last


def _rows_of_frames(telemetry: Telemetry, ends: Ends) -> Iterator[slice]:
    """Rows of a part that lie in each stretch, where there are any."""
    for first, last in ends:
        begin = int(np.searchsorted(telemetry.frame, first))
        end = int(np.searchsorted(telemetry.frame, last, side="right"))
        if begin < end:
            yield slice(begin, end)


def _matches_of_rows(matches: Matches, rows: slice) -> Matches:
    """The matches of some rows, which are whole frames."""
    e0, e1 = (int(place) for place in np.searchsorted(matches.exposure_start, [rows.start, rows.stop]))
    of = {True: rows, False: slice(e0, e1)}
    names = [item.name for item in fields(Matches) if item.name != "exposure_start"]
    arrays: dict[str, Any] = {name: getattr(matches, name)[of[name in OF_ROWS]] for name in names}
    return Matches(exposure_start=matches.exposure_start[e0 : e1 + 1] - rows.start, **arrays)
