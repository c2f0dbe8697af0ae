"""Departures from the model that are displacements of the stars, each with the fields that `displacements` tests.

With (x, y) a star's place from the principal point, in units of half the detector's diagonal, R^2 = x^2 + y^2, and L_j the Legendre
polynomials, which keep the fields of one departure apart:

=============  ====================================================================================================
`tangential`   (R^2 + 2 x^2, 2 x y) and (2 x y, R^2 + 2 y^2): the lens is decentred (Brown 1966)
`radial`       (x, y) L_j(2 R^2 - 1), j = 1 ... 4: distortion of higher order than the camera has
`affine`       (x, -y) and (y, x): pixels that are not square or not upright, and lines read out while the image moves steadily
`lens`         (L_i L_j, 0) and (0, L_i L_j), 1 <= i + j <= 3: any smooth residual of the lens
`edges`        centroids within `EDGE` of an edge drawn inwards or outwards, the more the nearer: windows that the edge cuts
`seam`         one half of the rows, or of the columns, displaced along either axis: halves that are read by their own amplifiers
`trail`        1 - exp(-p / `TRAIL`) along rows, or columns, with p the place as a share of the side: charge left behind
`flaw`         (p - p_0) / w exp(-|p - p_0|^2 / 2 w^2): at the place p_0 that `flaws` has found, of the width found there
`magnitude`    (m, 0), (0, m), (m x, m y) with m the star's magnitude: centroids pulled with brightness
`colour`       the same with its colour B-V
`phase`        sin and cos of 2 pi and 4 pi times the place in the pixel, along either axis: centroids drawn to its centre
`readout`      the image's velocity times the row, or the column: one line after another
`aberration`   v - (v.s) s with v the Earth's velocity, and the satellite's, in units of c, where times tell them, or else any
               constant one of so many km/s as `ANY_VELOCITY`: directions of another observer
`trend`        (x, y) L_1(time): a focal length that drifts one way, which six orders at once would hide
`refraction`   the lift of the air, A tan Z towards the zenith, of a usual pressure and temperature: once where it is missing
`time`         (x, y) L_j(time), j = 1 ... 6: a focal length that changes
`temperature`  (x, y) L_j(temperature), j = 1 ... 5
`drift`        every free parameter times L_1(time)
`exposure`     every free parameter times the place of the exposure in its frame, from -1 for the first to 1 for the last
=============  ====================================================================================================

The image's velocity comes from the attitudes of exposures that follow each other closely: with C_a and C_b a time t apart the
detector turns by w t, the rotation vector of C_b C_a^T, and a star at s moves by -w x s. Exposures that are `FAR_APART` or turn by
more than `FAR_TURN` say nothing of it.

The zenith of refraction is that of the sensor's site. Where nobody gave one, places all over the Earth are tried, those from which
every exposure looks up; of a set that looks all around the sky there are none. The place whose lift explains most is taken,
after two rounds about it that are each twice as near, and its probability is multiplied by the number of places tried, which holds
however they hang together. The lift of an exposure as a whole is a rotation and left out, for it is a hundred times the rest.

A departure whose numbers a set does not have is not tested, and `find_departures` says why.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray, TimeArray
from boresight.calibration.trust.displacements import Block, Departure, add_up, score_fields
from boresight.calibration.trust.fitted_set import FittedSet
from boresight.calibration.trust.flaws import Flaw, bump
from boresight.estimation.attitude import attitudes, rotation_vector, to_quaternion, triad
from boresight.site import Site
from boresight.sky.apparent import C_AU_DAY, C_M_S, days_since_j2000, earth_state
from boresight.sky.ground import lift, refraction_constants, view_from, zeniths_from
from boresight.telemetry.schema import MAGNITUDES, TEMPERATURES_C, within

#: Width of the edges, half diagonals: what a window of a few per cent of the detector's side reaches.
EDGE = 0.1
#: Share of the detector's side over which charge left behind comes to its full.
TRAIL = 0.3
#: Numbers of a departure that were looked for before it was tested: Schwarz's criterion counts them with its coefficients.
SOUGHT = {"flaw": 3}
#: Largest displacement at the corner by tangential terms of which the root of the sum of squares is one.
TANGENTIAL_AT_CORNER = 3.0
#: Orders of the polynomials above.
RADIAL, LENS, TIME, TEMPERATURE, HARMONICS = 4, 3, 6, 5, 2
#: Seconds between exposures, and the angle between them, rad, beyond which they do not tell a rate.
FAR_APART, FAR_TURN = 60.0, 0.2
#: Velocity that directions may lack where no time tells the Earth's, km/s.
ANY_VELOCITY = 20.0
#: Seconds that the lines over half the diagonal take to read where a coefficient is one.
READOUT_S = 0.03
#: Places on Earth that are tried, how low above their horizon an exposure may look, how often closer ones are tried; exposures that
#: tell which, and frames that tell the likeliest.
PLACES, LOWEST_DEG, CLOSER, PLACED, SEARCHED = 200, 8.0, 2, 500, 256
#: Air where nobody gave a site.
USUAL_SITE = Site(0.0, 0.0)
#: Frames that a change over them needs.
FEWEST_FRAMES = 20
#: Spread of a quantity below which nothing can depend on it.
SAME = 1e-9


@dataclass(frozen=True)
class Quantities:
    """Numbers of the stars and frames of a fitted set that fields are made of; None where the set has none, with the reason.

    `magnitude`, `colour`: (n_stars,) about their mean. `time`, `temperature`: (n_frames,) within -1 and 1. `missing`: what the
    set has not, with the reason.
    """

    magnitude: FloatArray | None
    colour: FloatArray | None
    time: FloatArray | None
    temperature: FloatArray | None
    missing: dict[str, str]


def find_departures(fitted: FittedSet) -> tuple[list[Departure], dict[str, str]]:
    """List the departures that can be tested in a set, and say by name why the others cannot."""
    known = find_quantities(fitted)
    found = [
        Departure("tangential", "detector", _tangential),
        Departure("radial", "detector", _radial),
        Departure("affine", "detector", _affine),
        Departure("lens", "detector", _lens),
        Departure("edges", "detector", _edges),
        Departure("seam", "detector", _seam),
        Departure("trail", "detector", _trail),
        Departure("phase", "detector", _phase),
        Departure("aberration", "sky", _aberration),
    ]
    air = _find_refraction(fitted)
    if isinstance(air, str):
        known.missing["refraction"] = air
    else:
        found.append(air)
    for name, values in (("magnitude", known.magnitude), ("colour", known.colour)):
        if values is not None:
            found.append(Departure(name, "detector", partial(_with, values)))
    if "rate" not in known.missing:
        found.append(Departure("readout", "detector", _readout))
    for name, values, order in (
        ("trend", known.time, 1),
        ("time", known.time, TIME),
        ("temperature", known.temperature, TEMPERATURE),
    ):
        if values is not None:
            found.append(Departure(name, "rows", partial(_scale_with, values, order)))
    if known.time is not None:
        found.append(Departure("drift", "rows", partial(_drift, known.time)))
    if "exposure" not in known.missing:
        found.append(Departure("exposure", "rows", _exposure))
    if isinstance(flaw := fitted.computed.get("flaw"), Flaw):
        found.append(Departure("flaw", "detector", partial(_flaw, flaw)))
    return found, known.missing


def find_companions(fitted: FittedSet) -> list[Departure]:
    """List fields that have no test of their own, for how far `magnitude` and `colour` mislead when they are noticed.

    `magnitude stretch`, `colour stretch`: (m x, -m y) and (m y, m x). `alike`: the fields of both with m one, for the star that is
    not displaced need not be the mean one.
    """
    known = find_quantities(fitted)
    return [
        Departure("alike", "detector", _alike),
        *(
            Departure(f"{name} stretch", "detector", partial(_stretched_with, values))
            for name, values in (("magnitude", known.magnitude), ("colour", known.colour))
            if values is not None
        ),
    ]


def find_quantities(fitted: FittedSet) -> Quantities:
    """Look up what the fields of a set may depend on, once."""
    if "quantities" not in fitted.computed:
        fitted.computed["quantities"] = _look_up(fitted)
    answer: Quantities = fitted.computed["quantities"]
    return answer


def _look_up(fitted: FittedSet) -> Quantities:
    missing: dict[str, str] = {}
    found: dict[str, FloatArray | None] = {}
    for name, find in SOURCES.items():
        values = find(fitted)
        found[name] = None if isinstance(values, str) else values
        if isinstance(values, str):
            missing[name] = values
    if why := _why_no_rate(fitted):
        missing["rate"] = why
    if fitted.arcs.n_exposures == fitted.arcs.n_frames:
        missing["exposure"] = "Every frame has one exposure."
    return Quantities(**found, missing=missing)


def _magnitude(fitted: FittedSet) -> FloatArray | str:
    given = fitted.telemetry.magnitude
    if given is None:
        return "The telemetry has no magnitudes."
    return _about_mean(within(given[fitted.arcs.source_row], MAGNITUDES), "All stars have one magnitude.")


def _colour(fitted: FittedSet) -> FloatArray | str:
    ids, catalogue = fitted.telemetry.star_id, fitted.catalogue
    if ids is None or catalogue is None:
        return "The telemetry gives no star numbers, so colours are not known."
    place = catalogue.find_index(ids[fitted.arcs.source_row])
    if not (place >= 0).any():
        return "None of the stars is in the catalogue, so their colours are unknown."
    return _about_mean(np.where(place >= 0, catalogue.colour_bv[place], np.nan), "All stars have one colour.")


def _about_mean(values: FloatArray, alike: str) -> FloatArray | str:
    """Values about their mean, zero where one is not known."""
    known = np.isfinite(values)
    if not known.any() or np.ptp(values[known]) < SAME:
        return alike
    return np.where(known, values - values[known].mean(), 0.0)


def _time(fitted: FittedSet) -> FloatArray | str:
    """Time of each frame, or its place in the set where there are no times."""
    n, given = fitted.arcs.n_frames, fitted.telemetry.time_utc
    if n < FEWEST_FRAMES:
        return f"A change over time needs {FEWEST_FRAMES} frames."
    if given is None or np.isnat(time := given[_first_rows(fitted)]).any():
        return np.linspace(-1.0, 1.0, n)
    return _within_one((time - time[0]) / np.timedelta64(1, "s"), "All frames have one time.")


def _temperature(fitted: FittedSet) -> FloatArray | str:
    given = fitted.telemetry.temperature_c
    if given is None:
        return "The telemetry has no temperatures."
    if fitted.arcs.n_frames < FEWEST_FRAMES:
        return f"A change with temperature needs {FEWEST_FRAMES} frames."
    values = within(given[_first_rows(fitted)], TEMPERATURES_C)
    known = np.isfinite(values)
    if not known.any():
        return "The telemetry has no temperatures."
    return _within_one(np.where(known, values, values[known].mean()), "All frames have one temperature.")


def _first_rows(fitted: FittedSet) -> FloatArray:
    """Row of the telemetry of one star of each frame, (n_frames,)."""
    arcs = fitted.arcs
    return np.asarray(arcs.source_row[arcs.star_start[arcs.frame_start[:-1]]])


def _within_one(values: FloatArray, alike: str) -> FloatArray | str:
    low, high = float(values.min()), float(values.max())
    return alike if not high - low > SAME else 2 * (values - low) / (high - low) - 1


def _why_no_rate(fitted: FittedSet) -> str:
    """Say why nothing tells how fast the image moves; empty where something does."""
    arcs, given = fitted.arcs, fitted.telemetry.time_utc
    if given is None:
        return "The telemetry has no times, so the rate of the image is unknown."
    if not len(_near(given[arcs.source_row[arcs.star_start[:-1]]])[0]):
        return "No exposures follow each other closely, so the rate of the image is unknown."
    return ""


def _near(time: NDArray[np.datetime64]) -> tuple[IntArray, FloatArray]:
    """Exposures, by their times (n_exposures,), that the next follows closely, and after how many seconds."""
    step = np.diff(time) / np.timedelta64(1, "s")
    near = np.flatnonzero((step > 0) & (step < FAR_APART))
    return near, step[near]


def _find_rates(block: Block) -> FloatArray:
    """Angular rates (n_exposures, 3) of a block about the axes of the triad, rad/s; zero where nothing tells one."""
    arcs, sensor, telemetry = block.arcs, block.fitted.problem.sensor, block.fitted.telemetry
    total, count = np.zeros((arcs.n_exposures, 3)), np.zeros(arcs.n_exposures)
    if telemetry.time_utc is None:
        return total
    near, step = _near(telemetry.time_utc[arcs.source_row[arcs.star_start[:-1]]])
    C = attitudes(arcs.star_start, block.on_detector[0], arcs.s_i, block.sigma_rad, sensor.parity).C
    turn = rotation_vector(to_quaternion(C[near + 1] @ C[near].transpose(0, 2, 1)))
    slow = np.linalg.norm(turn, axis=1) < FAR_TURN
    for place in (near[slow], near[slow] + 1):
        total[place] += turn[slow] / step[slow, None]
        count[place] += 1
    return np.asarray(total / np.maximum(count, 1)[:, None])


def _find_velocities(block: Block) -> FloatArray:
    """Velocities in units of c that the directions of a block may lack, (n_exposures, 3, n_velocities)."""
    arcs, telemetry = block.arcs, block.fitted.telemetry
    rows = arcs.source_row[arcs.star_start[:-1]]
    time = None if telemetry.time_utc is None else telemetry.time_utc[rows]
    if time is None or np.isnat(time).any():
        return np.broadcast_to(ANY_VELOCITY * 1e3 / C_M_S * np.eye(3), (arcs.n_exposures, 3, 3))
    found = [earth_state(days_since_j2000(time))[1] / C_AU_DAY]
    if telemetry.velocity_m_s is not None:
        found.append(np.nan_to_num(telemetry.velocity_m_s[rows]) / C_M_S)
    return np.stack(found, axis=-1)


SOURCES: dict[str, Callable[[FittedSet], FloatArray | str]] = {
    "magnitude": _magnitude,
    "colour": _colour,
    "time": _time,
    "temperature": _temperature,
}


def half_diagonal(fitted: FittedSet) -> float:
    """Half the diagonal of the detector, pixels: the unit of the fields' places."""
    sensor = fitted.problem.sensor
    return float(np.hypot(sensor.rows, sensor.columns) / 2)


def _places(block: Block) -> tuple[FloatArray, FloatArray]:
    """(x, y) of each star, (n_stars,) each."""
    row, col = block.fitted.problem.camera.principal_point(block.fitted.x)
    unit = half_diagonal(block.fitted)
    return (block.arcs.row_px - row) / unit, (block.arcs.col_px - col) / unit


def _pairs(*fields: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Fields (along rows, along columns) of (n_stars,) each, as (n_stars, 2, n_fields)."""
    return np.stack([np.stack(field, axis=-1) for field in fields], axis=-1)


def _tangential(block: Block) -> FloatArray:
    x, y = _places(block)
    r2, both = x**2 + y**2, 2 * x * y
    return _pairs((r2 + 2 * x**2, both), (both, r2 + 2 * y**2))


def _radial(block: Block) -> FloatArray:
    x, y = _places(block)
    L = legendre.legvander(2 * (x**2 + y**2) - 1, RADIAL)[:, 1:]
    return np.stack([x[:, None] * L, y[:, None] * L], axis=1)


def _affine(block: Block) -> FloatArray:
    x, y = _places(block)
    return _pairs((x, -y), (y, x))


def _lens(block: Block) -> FloatArray:
    x, y = _places(block)
    L_x, L_y = legendre.legvander(x, LENS), legendre.legvander(y, LENS)
    exponents = [(i, j) for i in range(LENS + 1) for j in range(LENS + 1 - i) if i + j]
    values = np.stack([L_x[:, i] * L_y[:, j] for i, j in exponents], axis=-1)
    none = np.zeros_like(values)
    return np.stack([np.concatenate([values, none], axis=1), np.concatenate([none, values], axis=1)], axis=1)


def _edges(block: Block) -> FloatArray:
    sensor = block.fitted.problem.sensor
    places = ((block.arcs.row_px, sensor.rows), (block.arcs.col_px, sensor.columns))
    return _pairs((_towards_edges(block, *places[0]), _towards_edges(block, *places[1])))


def _towards_edges(block: Block, place: FloatArray, pixels: int) -> FloatArray:
    """One at the far edge, minus one at the first, and nothing `EDGE` half diagonals from either."""
    reach = EDGE * half_diagonal(block.fitted)
    near, far = (np.maximum(1 - away / reach, 0.0) for away in (place, pixels - 1 - place))
    return np.asarray(far - near)


def _sides(block: Block) -> tuple[FloatArray, FloatArray]:
    """Row and column of each star as shares of the detector's sides."""
    sensor = block.fitted.problem.sensor
    return block.arcs.row_px / sensor.rows, block.arcs.col_px / sensor.columns


def _seam(block: Block) -> FloatArray:
    row, col = (np.where(place > 0.5, 1.0, 0.0) for place in _sides(block))
    none = np.zeros_like(row)
    return _pairs((row, none), (none, row), (col, none), (none, col))


def _trail(block: Block) -> FloatArray:
    row, col = (1 - np.exp(-place / TRAIL) for place in _sides(block))
    none = np.zeros_like(row)
    return _pairs((row, none), (none, col))


def _flaw(flaw: Flaw, block: Block) -> FloatArray:
    places = np.stack([block.arcs.row_px, block.arcs.col_px], axis=1)
    return bump(places[..., None], np.array([[flaw.row_px], [flaw.col_px]]), flaw.width_px)


def _phase(block: Block) -> FloatArray:
    found = np.zeros((block.arcs.n_stars, 2, 4 * HARMONICS))
    for axis, place in enumerate((block.arcs.row_px, block.arcs.col_px)):
        for k in range(HARMONICS):
            angle = 2 * np.pi * (k + 1) * place
            first = 2 * HARMONICS * axis + 2 * k
            found[:, axis, first], found[:, axis, first + 1] = np.sin(angle), np.cos(angle)
    return found


def _with(values: FloatArray, block: Block) -> FloatArray:
    """A shift along either axis, and a scale, that grow with a quantity of each star of the set."""
    m, (x, y) = values[block.stars], _places(block)
    none = np.zeros_like(m)
    return _pairs((m, none), (none, m), (m * x, m * y))


def _stretched_with(values: FloatArray, block: Block) -> FloatArray:
    """Stretches of the image that grow with a quantity of each star."""
    m, (x, y) = values[block.stars], _places(block)
    return _pairs((m * x, -m * y), (m * y, m * x))


def _alike(block: Block) -> FloatArray:
    """The same shifts, scale and stretches of all stars."""
    every = np.ones(block.fitted.arcs.n_stars)
    return np.concatenate([_with(every, block), _stretched_with(every, block)], axis=2)


def _aberration(block: Block) -> FloatArray:
    v = np.repeat(_find_velocities(block), np.diff(block.arcs.star_start), axis=0)
    return np.asarray(np.einsum("nij,nic->njc", block.in_sky[1], v))


def _find_refraction(fitted: FittedSet) -> Departure | str:
    """The departure of refraction above the sensor's site, or above the likeliest place; else why it cannot be tested."""
    sensor, site = fitted.problem.sensor, fitted.telemetry.site
    if sensor.declared.refraction == "none":
        return "The sensor declares that its images are from space."
    time = None if fitted.telemetry.time_utc is None else fitted.telemetry.time_utc[_first_row_of_exposures(fitted)]
    if time is None or np.isnat(time).any():
        return "The telemetry has no times, so the zenith direction is unknown."
    if site is not None:
        zenith = view_from(site, time).zenith
        return Departure("refraction", "sky", partial(_lifted, zenith[:, None], refraction_constants(site)))
    places = _places_that_look_up(fitted, time)
    if not len(places):
        return "The exposures look all around the sky: they are not from one place on the ground."
    place, trials = _likeliest_place(fitted, time, places)
    return Departure(
        "refraction", "sky", partial(_lifted, zeniths_from(place[None], time), refraction_constants(USUAL_SITE)), trials
    )


def _first_row_of_exposures(fitted: FittedSet) -> IntArray:
    """Row of the telemetry of one star of each exposure, (n_exposures,)."""
    arcs = fitted.arcs
    return np.asarray(arcs.source_row[arcs.star_start[:-1]])


def _places_that_look_up(fitted: FittedSet, time: TimeArray) -> FloatArray:
    """Places on Earth (n, 3), evenly spread, above whose horizon every exposure stands."""
    k = np.arange(PLACES) + 0.5
    z, around = 1 - 2 * k / PLACES, k * np.pi * (3 - np.sqrt(5))
    places = np.stack([np.sqrt(1 - z**2) * np.cos(around), np.sqrt(1 - z**2) * np.sin(around), z], axis=-1)
    some = np.linspace(0, len(time) - 1, min(len(time), PLACED)).round().astype(int)
    look = fitted.arcs.s_i[fitted.arcs.star_start[some]]
    lowest = np.einsum("nkj,nj->nk", zeniths_from(places, time[some]), look).min(axis=0)
    return np.asarray(places[lowest > np.sin(np.radians(LOWEST_DEG))])


def _likeliest_place(fitted: FittedSet, time: TimeArray, places: FloatArray) -> tuple[FloatArray, int]:
    """The place (3,) whose lift explains most of the residuals, and of how many; from some of the frames."""
    best, trials, step = places[0], 0, np.sqrt(4 * np.pi / PLACES) / 2
    for _ in range(1 + CLOSER):
        trials += len(places)
        zenith = zeniths_from(places, time)
        lift = partial(_lifted, zenith, refraction_constants(USUAL_SITE))
        sums = add_up(fitted, [Departure("places", "sky", lift)], SEARCHED)
        falls = [score_fields(sums, np.array([k])).statistic for k in range(len(places))]
        best = places[int(np.argmax(falls))]
        places, step = _about(best, step), step / 2
    return best, trials


def _about(place: FloatArray, step: float) -> FloatArray:
    """A place (3,) and six at a distance from it, rad, (7, 3)."""
    across = np.cross(place, np.eye(3)[np.argmin(np.abs(place))])
    across /= np.linalg.norm(across)
    up, angle = np.cross(place, across), np.arange(6) * np.pi / 3
    ring = np.cos(step) * place + np.sin(step) * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up)
    return np.concatenate([place[None], ring])


def _lifted(zenith: FloatArray, constants: tuple[float, float], block: Block) -> FloatArray:
    """How far air lifts each star, less the turn of its exposure, with zeniths (n_exposures, n_fields, 3) of the whole set."""
    arcs = block.arcs
    first = int(block.fitted.arcs.frame_start[block.first])
    here, counts = zenith[first : first + arcs.n_exposures], np.diff(arcs.star_start)
    s, axes = block.in_sky
    middle = np.add.reduceat(s, arcs.star_start[:-1], axis=0)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    found = np.empty((len(s), 2, zenith.shape[1]))
    for k in range(zenith.shape[1]):
        turn = np.cross(middle, lift(middle, here[:, k], *constants))
        of_star = lift(s, np.repeat(here[:, k], counts, axis=0), *constants)
        of_star -= np.cross(np.repeat(turn, counts, axis=0), s)
        found[:, :, k] = np.einsum("ni,nic->nc", of_star, axes)
    return found


def _readout(block: Block) -> FloatArray:
    """The image's velocity times the row and times the column, px, where half the diagonal takes `READOUT_S` to read."""
    arcs, parity = block.arcs, block.fitted.problem.sensor.parity
    s, J = block.on_detector
    w = np.repeat(_find_rates(block), np.diff(arcs.star_start), axis=0)
    moved = triad(np.cross(triad(s, parity), w), parity)
    a, b, c = (np.einsum("ni,ni->n", J[:, :, i], J[:, :, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    along = np.einsum("nij,ni->nj", J, moved)
    determinant = a * c - b * b
    velocity = np.stack([c * along[:, 0] - b * along[:, 1], a * along[:, 1] - b * along[:, 0]], axis=1)
    velocity *= READOUT_S / determinant[:, None]
    x, y = _places(block)
    return np.stack([velocity * x[:, None], velocity * y[:, None]], axis=-1)


def _scale_with(values: FloatArray, order: int, block: Block) -> FloatArray:
    """Rows of a scale of the image that changes with a quantity of the frame."""
    L = legendre.legvander(values[block.frame_of_arc], order)[:, 1:]
    if "scale" not in block.computed:
        block.computed["scale"] = block.displace(_pairs(_places(block)), "detector")
    return block.computed["scale"] * L


def _drift(time: FloatArray, block: Block) -> FloatArray:
    return np.asarray(-block.H * time[block.frame_of_arc][:, None])


def _exposure(block: Block) -> FloatArray:
    arcs = block.arcs
    many = np.diff(arcs.frame_start)
    first = np.repeat(arcs.frame_start[:-1], many)
    place = 2 * (np.arange(arcs.n_exposures) - first) / np.maximum(np.repeat(many, many) - 1, 1) - 1
    level = np.where(np.repeat(many, many) > 1, place, 0.0)
    return np.asarray(-block.H * np.repeat(level, 2 * np.diff(arcs.star_start) - 3)[:, None])
