"""The part of a large set that fits into memory: whole blocks of its frames, evenly spread, the first and the last among them.

Pictures of residuals, the trust tab, the shadow and the alignment need every star of what they judge at once. Three hundred
thousand stars tell a residual's mean over a cell of the detector to a hundredth of a pixel; more would change no picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from boresight.estimation.arcs import Arcs
from boresight.estimation.blocks import FRAMES
from boresight.telemetry.schema import Telemetry, joined, rows_of

#: Stars up to which a set is judged whole, and of a larger one so many are.
JUDGED_WHOLE = 500_000
JUDGED_STARS = 300_000


def spread_blocks(n_blocks: int, most: int) -> NDArray[np.int64]:
    """Places of at most so many of the blocks, evenly spread; at least one."""
    return np.unique(np.linspace(0, n_blocks - 1, max(1, min(most, n_blocks))).round().astype(np.int64))


def judged_telemetry(arcs: Arcs, parts: Callable[[], Iterable[Telemetry]]) -> Telemetry:
    """Rows of a set that are judged: all of them, or a sample of a large one; `parts` yields the set as it came."""
    if arcs.n_stars <= JUDGED_WHOLE:
        return joined(list(parts()))
    return sampled_telemetry(arcs, parts(), JUDGED_STARS)


def sampled_telemetry(arcs: Arcs, parts: Iterable[Telemetry], stars: int) -> Telemetry:
    """Rows of evenly spread blocks with about so many stars in all, and of the frames between that take no part.

    Parameters
    ----------
    arcs
        Of the set; not empty.
    parts
        The set as it came, whole frames a part.
    stars
        How many at most, but one block in any case.
    """
    n_blocks = -(-arcs.n_frames // FRAMES)
    chosen = spread_blocks(n_blocks, stars * n_blocks // arcs.n_stars)
    ends = [_ends(arcs, int(block)) for block in chosen]
    return joined([rows for part in parts for first, last in ends if len(rows := _rows_between(part, first, last))])


def _ends(arcs: Arcs, block: int) -> tuple[int, int]:
    """First and last frame number of a block."""
    places = block * FRAMES, min((block + 1) * FRAMES, arcs.n_frames) - 1
    first, last = (int(arcs.frames(place, place + 1).frame[0]) for place in places)
    return first, last


def _rows_between(telemetry: Telemetry, first: int, last: int) -> Telemetry:
    """Rows of the frames numbered first to last."""
    begin, end = np.searchsorted(telemetry.frame, [first, last + 1])
    return rows_of(telemetry, slice(int(begin), int(end)))
