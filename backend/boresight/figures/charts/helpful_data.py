"""Which data would tell apart what these data cannot: read off the weakest directions, the coverage and the square-root law.

A direction is made of parameters that do alike to the stars at hand. Focal length and distortion do alike where stars fill a narrow
range of radii; principal point and tilts do alike unless stars stand far out on both sides; an aspect factor needs arcs along
rows and along columns. More frames like these divide the sigma of a direction by the square root of their number.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from boresight.estimation.statistics.observability import NAMED, WEAK
from boresight.figures.chart import Result
from boresight.verdicts.numbers import count, percent
from boresight.verdicts.quantities import quantity

REACH_ENOUGH = 0.95  # of the way to the corner
MOST_TIMES = 100.0  # more frames than so many times these are no advice
FAMILIES: tuple[tuple[frozenset[str], str], ...] = (
    (
        frozenset({"f_m", "b4_per_m4", "b2_per_m2", "k1", "k2"}),
        "stars at all radii, near the centre and in the corners: they part focal length from distortion",
    ),
    (
        frozenset({"m0_px", "n0_px", "u0_px", "v0_px", "a1_rad", "a2_rad"}),
        "stars far out on opposite sides of the detector: they part the principal point from the tilts",
    ),
    (
        frozenset({"g_y", "s"}),
        "pairs of stars along rows and along columns: they part the aspect from the focal length",
    ),
)


def weakest_words(result: Result) -> str:
    """Write the weakest direction as a sum of parameters, such as `0.82 m0 + 0.55 a2`; empty where it is not known."""
    shares = _shares(result)
    named = {name: share for name, share in shares.items() if abs(share) >= NAMED}
    terms = sorted(named.items(), key=lambda item: -abs(item[1]))
    text = " ".join(
        f"{'−' if share < 0 else '+'} {abs(share):.2f} {quantity(name, result).symbol}" for name, share in terms
    )
    return text.removeprefix("+ ")


def helpful_data(result: Result) -> list[str]:
    """Say in a sentence each which data would help the weakest direction most; none where observability is not known."""
    shares = _shares(result)
    if not shares:
        return []
    named = {name for name, share in shares.items() if abs(share) >= NAMED}
    wanted = [f"Frames with {words}." for family, words in FAMILIES if named & family]
    return [*wanted, *_reach(result), *_frames(result)]


def _shares(result: Result) -> Mapping[str, float]:
    """Read the weakest direction's components by parameter."""
    seen: Mapping[str, Any] = result.get("observability") or {}
    direction = (seen.get("weakest") or {}).get("direction") or {}
    return {name: float(share) for name, share in direction.items() if share is not None}


def _reach(result: Result) -> list[str]:
    """Say where on the detector no star was."""
    said = []
    radial, coverage = result.get("radial") or {}, result.get("coverage") or {}
    reached, radii = radial.get("data_radius_px"), radial.get("radius_px") or [0.0]
    if reached is not None and radii[-1] > 0 and reached < REACH_ENOUGH * radii[-1]:
        said.append(f"Stars reach {percent(reached / radii[-1], 0)} of the way to the farthest corner: go farther out.")
    counts = np.array(coverage.get("counts") or [], dtype=np.float64)
    empty = int((counts == 0).sum())
    if empty:
        said.append(
            f"{count(empty)} of {count(counts.size)} cells of the detector have no star: point so that they get some."
        )
    return said


def _frames(result: Result) -> list[str]:
    """Say how many frames like these would make the weakest direction known, by the square-root law."""
    spread = (result.get("observability") or {}).get("sigma_of_direction") or []
    frames = result.get("frames")
    if not spread or not frames:
        return []
    if spread[-1] is None:
        return ["More frames like these would leave the weakest direction as open as it is."]
    times = (float(spread[-1]) / WEAK) ** 2
    if times <= 1:
        return ["Every direction is known: more frames narrow all sigmas by the square root of their number."]
    if times > MOST_TIMES:
        return [f"Frames like these alone would not do: it would take {count(round(times))} times as many."]
    return [f"About {count(np.ceil(times * frames))} frames like these, in place of {count(frames)}, would do as well."]
