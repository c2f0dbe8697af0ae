"""The frames of a run: one on the detector with its residuals at a stated scale, also as tables, and links to the worst ones.

All of the view is in the address: `frame`, `exposure`, `scale`, `show`. A residual points from the measured centroid to
the predicted place; the circle is three of its sigmas, drawn to the same scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any
from urllib.parse import urlencode

from fastapi import Request

from boresight.console.access.dependencies import get_server
from boresight.console.runs import frames
from boresight.console.runs.frames import FrameLine
from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.estimation.statistics.consistency import CLEAR_SIGMAS
from boresight.platform.db.sessions import Session
from boresight.verdicts.numbers import MISSING, fixed, number

SCALES: tuple[int, ...] = tuple(step * 10**power for power in range(5) for step in (1, 2, 5))
TYPICAL_SHARE = 0.03  # of the detector's width: the length of the typical residual
BAR_SHARE = 0.1  # of the detector's width: about the length of the scale bar
MARGIN_SHARE = 0.06  # of the width, for the axes
TICKS = 6


@dataclass(frozen=True)
class Vector:
    """A residual: its parameters (old or new), its components and the mean of its two sigmas, px (x along columns)."""

    name: str
    dx: float
    dy: float
    sigma: float


@dataclass(frozen=True)
class DetectionSymbol:
    """A detection: its position (x along columns), its state, its tooltip, and its residuals."""

    row: int
    x: float
    y: float
    fate: str
    title: str
    vectors: tuple[Vector, ...]


@dataclass(frozen=True)
class FrameDrawing:
    """Everything that the template draws, px of the detector."""

    width: int
    height: int
    margin: float
    scale: int
    bar_px: float
    symbols: Sequence[DetectionSymbol]
    missed: Sequence[Mapping[str, Any]]
    x_ticks: Sequence[int]
    y_ticks: Sequence[int]
    names: Sequence[str]


def draw_frame(view: Mapping[str, Any], exposure: Mapping[str, Any], names: Sequence[str], scale: int) -> FrameDrawing:
    """Lay an exposure out."""
    return FrameDrawing(
        width=view["columns"],
        height=view["rows"],
        margin=MARGIN_SHARE * view["columns"],
        scale=scale,
        bar_px=round_down(BAR_SHARE * view["columns"] / scale),
        symbols=[_symbol(star, names) for star in exposure["stars"]],
        missed=exposure["undetected"],
        x_ticks=_ticks(view["columns"]),
        y_ticks=_ticks(view["rows"]),
        names=names,
    )


def usual_scale(stars: Sequence[Mapping[str, Any]], names: Sequence[str], columns: int) -> int:
    """Choose the scale at which the typical residual of the used stars is easy to see."""
    lengths: list[float] = [
        math.hypot(*star[name]["d_px"]) for star in stars for name in names if star[name] and star["fate"] == "used"
    ]
    typical = median(lengths) if lengths else 0.0
    wanted: float = TYPICAL_SHARE * columns / typical if typical > 0 else 1.0
    return max((scale for scale in SCALES if scale <= wanted), default=SCALES[0])


def round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above the value, which is positive."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9))


def _ticks(size: int) -> list[int]:
    step = max(1, int(round_down(2 * size / TICKS)))
    return list(range(0, size, step))


def _symbol(star: Mapping[str, Any], names: Sequence[str]) -> DetectionSymbol:
    vectors = tuple(
        Vector(name, star[name]["d_px"][1], star[name]["d_px"][0], sum(star[name]["sigma_px"]) / 2)
        for name in names
        if star[name]
    )
    return DetectionSymbol(
        star["row"], star["col_px"], star["row_px"], star["fate"].replace(" ", "-"), _title(star), vectors
    )


def _title(star: Mapping[str, Any]) -> str:
    number = star["star_id"] or star["given_star_id"]
    said = [f"HIP {number}" if number else "no star", star["fate"]]
    if star["reason"]:
        said.append(star["reason"])
    for name in ("old", "new"):
        if star[name]:
            row, col = star[name]["d_px"]
            said.append(f"{name}: rows {row:+.3f} px, columns {col:+.3f} px")
    return "; ".join(said)


SHOWN = {"new": "New parameters", "old": "Old parameters", "both": "Both"}
UNDER = {"new": ("new",), "old": ("old",), "both": ("old", "new")}
WORST_SHOWN = 8
ATTITUDE = (
    "Right ascension of the boresight (°)",
    "Declination of the boresight (°)",
    "Roll (°): position angle of increasing rows",
    "σ about x, y, z (arcsec)",
    "Quaternion x, y, z, w",
    "Stars used",
    "RMS residual (px, per axis)",
    "χ² of its residuals, and degrees of freedom",
    "Rotation from the telemetry's quaternion (arcsec, about x, y, z)",
)
GONE = "No frame can be shown: {}"


@dataclass(frozen=True)
class FramePage:
    """What the template draws."""

    why: str | None = None
    code: str = ""
    view: Mapping[str, Any] | None = None
    exposure: Mapping[str, Any] | None = None
    drawing: FrameDrawing | None = None
    attitude: Sequence[tuple[str, str, str]] = ()
    stars: Sequence[Mapping[str, Any]] = ()
    worst: Sequence[FrameLine] = ()
    address: Mapping[str, str] | None = None
    image: str | None = None

    def to(self, **changes: Any) -> str:
        """Return the address of this view with changes; None removes a parameter."""
        kept = {"part": "evidence", "frame": "", **(self.address or {}), **changes}
        return "?" + urlencode({name: value for name, value in kept.items() if value is not None})


def make_frames_part(session: Session, request: Request, run: Run) -> dict[str, Any]:
    """Gather the frames part of a run page; where no frame can be shown a sentence says why."""
    asked = {name: request.query_params[name] for name in ("exposure", "scale", "show") if name in request.query_params}
    state = get_server(request)
    try:
        worst = frames.list_frames(session, state.blobs, run.id, order="worst", limit=WORST_SHOWN)
        chosen = _asked_frame(request.query_params.get("frame")) or _first(session, state.blobs, run, worst)
    except BoresightError as refusal:
        return _page(FramePage(why=GONE.format(refusal), code=refusal.code, address=asked))
    try:
        view = frames.get_frame(
            session, state.blobs, state.catalogue(), state.settings.catalogue_folder, run.id, int(chosen)
        )
    except BoresightError as refusal:
        return _page(FramePage(why=GONE.format(refusal), code=refusal.code, worst=worst, address=asked))
    page = _laid_out(view, worst, {"frame": str(chosen), **asked})
    if telemetry_sets.has_images(session, run.telemetry_set_id):
        page = replace(page, image=f"/telemetry/{run.telemetry_set_id}/images/{int(chosen)}.png")
    return _page(page)


def _page(page: FramePage) -> dict[str, Any]:
    return {"frames": page, "shown": SHOWN, "scales": SCALES, "clear_sigma": CLEAR_SIGMAS}


def _asked_frame(text: str | None) -> str | None:
    """Read the requested frame's number, None where there is none; refuse a text that is no number."""
    if not text:
        return None
    if not text.removeprefix("-").isdecimal() or len(text) > 18:
        raise RefusedInputError(
            f"{text[:20]!r} is not a frame number; write one that the telemetry contains.", code="not-a-frame-number"
        )
    return text


def _first(session: Session, blobs: Any, run: Run, worst: Sequence[FrameLine]) -> str:
    lines = worst or frames.list_frames(session, blobs, run.id, limit=1)
    if not lines:
        raise NotFoundError("The telemetry of this run has no frames; choose another run.")
    return str(lines[0].frame)


def _laid_out(view: Mapping[str, Any], worst: Sequence[FrameLine], address: Mapping[str, str]) -> FramePage:
    exposure = _chosen(view["exposures"], address.get("exposure"))
    if exposure is None:
        return FramePage(why=GONE.format(view["why_nothing"]), view=view, worst=worst, address=address)
    show = address.get("show", "new")
    names = [name for name in UNDER.get(show, UNDER["new"]) if exposure["attitude"][name]]
    if not names and view["why_no_new"]:
        names = ["old"]  # there are no other frames
    scale = _read_scale(address.get("scale")) or usual_scale(exposure["stars"], names, view["columns"])
    return FramePage(
        view=view,
        exposure=exposure,
        drawing=draw_frame(view, exposure, names, scale),
        attitude=attitude_rows(exposure["attitude"]),
        stars=[star_row(star) for star in exposure["stars"]],
        worst=worst,
        address=address,
    )


def _chosen(exposures: Sequence[Mapping[str, Any]], asked: str | None) -> Mapping[str, Any] | None:
    """Return the requested exposure, else the first."""
    by_number = {str(exposure["exposure"]): exposure for exposure in exposures}
    return by_number.get(asked or "", next(iter(exposures), None))


def _read_scale(text: str | None) -> int | None:
    return int(text) if text and text.isdecimal() and int(text) in SCALES else None


def attitude_rows(attitude: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return an exposure's attitude under the old and the new parameters, one row per quantity."""
    old, new = ([*_written(attitude[name])] if attitude[name] else [MISSING] * len(ATTITUDE) for name in ("old", "new"))
    return list(zip(ATTITUDE, old, new, strict=True))


def _written(attitude: Mapping[str, Any]) -> Iterator[str]:
    """Yield the numbers of an attitude as text, in the order of `ATTITUDE`."""
    yield fixed(attitude["ra_deg"], 6)
    yield fixed(attitude["dec_deg"], 6)
    yield fixed(attitude["roll_deg"], 5)
    yield _lines(attitude["sigma_arcsec"])
    yield "\n".join(fixed(value, 9) for value in attitude["quaternion"])
    yield str(attitude["stars"])
    yield number(attitude["rms_px"], 3)
    yield f"{number(attitude['chi2'], 3)} of {attitude['dof']}"
    yield _lines(attitude["from_telemetry_arcsec"])


def _lines(values: Sequence[float] | None) -> str:
    return MISSING if values is None else "\n".join(number(value, 3) for value in values)


def star_row(star: Mapping[str, Any]) -> dict[str, Any]:
    """Write a detection as a row of the table."""
    new, old = star["new"], star["old"]
    worst = None if new is None else max(new["normalised"], key=abs)
    return {
        "row": star["row"],
        "star": star["star_id"] or star["given_star_id"],
        "magnitude": fixed(star["catalogue_magnitude"] if star["magnitude"] is None else star["magnitude"], 2),
        "fate": star["fate"],
        "why": _why(star),
        "measured": (fixed(star["row_px"], 3), fixed(star["col_px"], 3)),
        "predicted": (MISSING, MISSING) if new is None else (fixed(new["row_px"], 3), fixed(new["col_px"], 3)),
        "residual": _residual(new),
        "apart": MISSING if new is None else fixed(new["apart_arcsec"], 2),
        "normalised": _pair(new, "normalised", 1),
        "worst": None if worst is None else abs(worst),
        "beyond": worst is not None and abs(worst) > CLEAR_SIGMAS,
        "old_residual": _residual(old),
        "old_normalised": _pair(old, "normalised", 1),
    }


def _why(star: Mapping[str, Any]) -> str:
    """Return why a star was not used, its flags in the catalogue, and another identity it was given."""
    renamed = star["star_id"] and star["given_star_id"] not in {None, star["star_id"]}
    said = [star["reason"], *star["flags"], f"named {star['given_star_id']} in the file" if renamed else None]
    if star["star_id"] and star["old_star_id"] is None:
        said.append("not matched under the old parameters")
    return "; ".join(phrase for phrase in said if phrase)


def _residual(under: Mapping[str, Any] | None) -> tuple[str, str]:
    """Return the residual with its sigma along rows and columns, px."""
    if under is None:
        return MISSING, MISSING
    row, col = (
        f"{fixed(value, 3)} ± {fixed(sigma, 3)}" for value, sigma in zip(under["d_px"], under["sigma_px"], strict=True)
    )
    return row, col


def _pair(under: Mapping[str, Any] | None, name: str, decimals: int) -> str:
    return MISSING if under is None else ", ".join(fixed(value, decimals) for value in under[name])
