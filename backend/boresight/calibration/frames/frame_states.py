"""The two states that a frame of a run is shown under, and the frame's stars as the run identified them.

Old are the sensor's parameters when the run was launched, new those of its result. With `match` "rematch" a run keeps no
matches, so the frame is matched again here, on its own: what the stars of a frame say of the parameters serves that frame alone
(`sky.matching`), so the answer is the run's, but for a frame that could only be started from a neighbour's attitude; for such
a one its neighbours are matched too. A filter matched each frame with what it knew by then; here its last parameters are taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.estimate import Parameters
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Frames on either side that are matched too where a frame alone gives nothing to start from.
NEIGHBOURS = 10


@dataclass(frozen=True)
class State:
    """Parameters to show a frame under.

    `x`: (n_parameters,) SI.
    """

    x: FloatArray
    freedom: FreeCovariance


@dataclass(frozen=True)
class RunStates:
    """What a run's calibration JSON says of its states.

    `P`: (n_free, n_free) covariance of the new ones in typical sigmas.
    """

    sensor: Sensor
    settings: CalibrationSettings
    parameters: Parameters
    old: State
    new: State | None
    P: FloatArray
    noise: float


def read_run_states(result: Mapping[str, Any], sensor: Sensor, settings: CalibrationSettings) -> RunStates:
    """Read the states of a run."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    wanted = sensor.free if settings.free is None else settings.free
    free = np.array([place for place, name in enumerate(names) if name in wanted], np.int64)
    scale = sensor.typical_sigma[free]
    P = _covariance(result, [names[place] for place in free], scale, settings.initial_sigma_scale)
    nothing = FreeCovariance(free, scale, np.zeros_like(P))
    # only a batch's covariance is that of this very fit, see `frame_view`
    fitted = nothing if settings.sequential else FreeCovariance(free, scale, _known(result, P))
    x = _estimate(result, names)
    excess = 1.0 if settings.sequential else max(1.0, float(result.get("chi2_per_dof") or 1.0))
    return RunStates(
        sensor=sensor,
        settings=settings,
        parameters=Parameters(free, scale),
        old=State(sensor.initial, nothing),
        new=None if x is None else State(x, fitted),
        P=P * excess,
        noise=float(np.sqrt(excess)),
    )


def _estimate(result: Mapping[str, Any], names: tuple[str, ...]) -> FloatArray | None:
    """The result's parameters, (n_parameters,); None where there are none to show anything under."""
    values = result.get("parameters")
    if not values or result.get("status") == "diverged" or any(values.get(name) is None for name in names):
        return None
    return np.array([values[name] for name in names], np.float64)


def _covariance(result: Mapping[str, Any], names: list[str], scale: FloatArray, start: float) -> FloatArray:
    """Covariance of the free parameters in typical sigmas; one that the result does not know is as uncertain as at the start."""
    known = result.get("covariance") or {"names": [], "matrix": []}
    P = np.eye(len(names)) * start**2
    places = [names.index(name) for name in known["names"] if name in names]
    if places and len(places) == len(known["names"]):
        matrix = np.array(known["matrix"], np.float64) / np.outer(scale[places], scale[places])
        P[np.ix_(places, places)] = matrix
    return P


def _known(result: Mapping[str, Any], P: FloatArray) -> FloatArray:
    """The same as far as data decided it; zero where the result leaves a parameter open."""
    complete = len((result.get("covariance") or {}).get("names") or ()) == len(P)
    return P if complete else np.zeros_like(P)


Read = Callable[[int], tuple[Telemetry, slice]]


@dataclass(frozen=True)
class MatchedFrame:
    """A frame as matched under both states; each is of `rows` of `telemetry`, which may hold neighbours too."""

    telemetry: Telemetry
    rows: slice
    old: Matched
    new: Matched


def match_frame(states: RunStates, read: Read, catalogue: Catalogue, cache_folder: Path | None) -> MatchedFrame:
    """Match a frame under both states, with its neighbours where it cannot be matched alone."""
    found = _matched(states, *read(0), catalogue, cache_folder)
    if not (_rematched(states, found.telemetry) and _lost(found)):
        return found
    return _matched(states, *read(NEIGHBOURS), catalogue, cache_folder)


def _rematched(states: RunStates, telemetry: Telemetry) -> bool:
    """Whether stars are identified again; a file that gives directions but names no stars keeps its own."""
    return states.settings.match == "rematch" and not (telemetry.star_id is None and telemetry.ra_rad is not None)


def _lost(found: MatchedFrame) -> bool:
    """Whether no exposure of the frame is valid under the new state."""
    of_frame = found.new.matches.frame == found.telemetry.frame[found.rows.start]
    return not bool(np.any(found.new.matches.reason[of_frame] == 0))


def _matched(
    states: RunStates, telemetry: Telemetry, rows: slice, catalogue: Catalogue, cache_folder: Path | None
) -> MatchedFrame:
    """Match some frames under both states."""
    settings = states.settings if _rematched(states, telemetry) else replace(states.settings, match="given")
    sets = Dataset(telemetry, states.sensor, catalogue, states.parameters, settings, cache_folder)
    old = sets.at_start()
    with_old = states.new is None or (settings.sequential and settings.matched_with == "baseline")
    new = old if with_old or states.new is None else sets.at_covariance(states.new.x, states.P, states.noise)
    return MatchedFrame(telemetry, rows, old, new)
