"""A calibration with everything that trust is judged from, for the tests of its parts."""

from dataclasses import dataclass, replace
from unittest import mock

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.calibration import result
from boresight.calibration.calibrate import calibrate
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.trust import trust_view
from boresight.calibration.trust.fitted_set import FittedSet, fit_best
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from tests.estimation.fields import COLUMNS, NOISE_PX, PITCH, ROWS, TRUTH


@dataclass(frozen=True)
class Case:
    problem: Problem
    parameters: Parameters
    settings: CalibrationSettings
    estimate: Estimate
    telemetry: Telemetry
    catalogue: Catalogue

    @property
    def ground(self) -> FittedSet:
        return fit_best(**vars(self))

    @property
    def trust(self) -> dict:
        return trust_view(**vars(self))


def case(telemetry, sensor, catalogue, **settings):
    chosen = CalibrationSettings(**{"match": "given", **settings})
    with (
        mock.patch.object(result, "document", wraps=result.document) as written,
        mock.patch("boresight.calibration.calibrate.evaluate_result"),  # judged here, part by part
    ):
        calibrate(telemetry, sensor, catalogue, chosen)
    return Case(*written.call_args.args[:4], telemetry, catalogue)


def field(seed, frames=40, stars=12, exposures=2, parity=1, noise_px=NOISE_PX):
    rng = np.random.default_rng(seed)
    n = frames * exposures * stars
    row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
    s_d = INVERTED_WANG.directions(TRUTH, row, col, PITCH) * np.array([1.0, parity, 1.0])
    turns = Rotation.random(frames * exposures, rng=rng).as_matrix()
    s_i = np.einsum("eij,eni->enj", turns, s_d.reshape(-1, stars, 3)).reshape(n, 3)
    return Telemetry(
        frame=np.repeat(np.arange(frames), exposures * stars),
        exposure=np.tile(np.repeat(np.arange(exposures), stars), frames),
        row_px=row + noise_px * rng.normal(size=n),
        col_px=col + noise_px * rng.normal(size=n),
        star_id=np.arange(1, n + 1),
        ra_rad=np.arctan2(s_i[:, 1], s_i[:, 0]),
        dec_rad=np.arcsin(s_i[:, 2]),
    )


def simulated(catalogue, number=1, frames=120, seed=0, changes=None, sky=None, **settings):
    scenario = replace(calibration_scenario(number, frames), **(changes or {}))
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    return case(telemetry, st16_sensor(number), catalogue if sky is None else sky, **settings)
