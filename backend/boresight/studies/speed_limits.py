"""What is promised of the compiled loops: their time beside C's for the same arithmetic, and what a second thread gains.

Ours and C's take turns, each on the whole set, and the fastest turn of each counts: what else the machine does meets all of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.blocks import computing_on
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.studies import c_peer
from boresight.studies.repeats import fastest_of_each

#: Times C's at most, and how many times faster two threads are at least.
OVER_C, TWO_THREADS = 1.25, 1.6
EVALUATION_TURNS, FILTER_TURNS, THREAD_TURNS = 40, 15, 20


def beside_c(arcs: ArcSet, x_0: FloatArray, scale: FloatArray, start_sigma: float) -> dict[str, dict[str, float]]:
    """Time the evaluation and the filter with their C peers, seconds: `ours` and every variant of C that compiles."""
    free, pooled = np.arange(len(scale)), pool_start(arcs, START_ARCS_PER_PARAMETER * len(scale))
    begin = start(x_0, len(scale), start_sigma)
    with c_peer.compiled() as peers:
        evaluation: dict[str, Callable[[], object]] = {
            "ours": partial(batch.normal_equations, arcs, x_0, free, scale),
            **{name: partial(peer.normal_equations, arcs, x_0, scale) for name, peer in peers.items()},
        }
        sqrf: dict[str, Callable[[], object]] = {
            "ours": partial(FILTERS["sqrf"], pooled, begin, free, scale, Tuning()),
            **{name: partial(peer.square_root_filter, pooled, begin, scale, Tuning()) for name, peer in peers.items()},
        }
        return {
            "evaluation": dict(
                zip(evaluation, fastest_of_each(*evaluation.values(), repeats=EVALUATION_TURNS), strict=True)
            ),
            "sqrf": dict(zip(sqrf, fastest_of_each(*sqrf.values(), repeats=FILTER_TURNS), strict=True)),
        }


def two_threads(arcs: ArcSet, x_0: FloatArray, scale: FloatArray) -> float | None:
    """How many times faster two threads evaluate a set of many blocks; None on one core."""
    if (os.cpu_count() or 1) < 2:
        return None
    alone = partial(batch.normal_equations, arcs, x_0, np.arange(len(scale)), scale)

    def together() -> None:
        with computing_on(2):
            alone()

    one, two = fastest_of_each(alone, together, repeats=THREAD_TURNS)
    return one / two


def limits(times: dict[str, dict[str, float]], gain: float | None) -> dict[str, dict[str, Any]]:
    """Hold the figures against what is promised, the faster variant of C where there are two; null where nothing was measured."""
    held: dict[str, dict[str, Any]] = {}
    for work, found in times.items():
        peers = [seconds for name, seconds in found.items() if name != "ours"]
        ratio = found["ours"] / min(peers) if peers else None
        held[f"{work}_over_c"] = {
            "limit": OVER_C,
            "measured": ratio,
            "kept": None if ratio is None else ratio <= OVER_C,
        }
    kept = None if gain is None else gain >= TWO_THREADS
    return held | {"two_threads": {"limit": TWO_THREADS, "measured": gain, "kept": kept, "at_least": True}}
