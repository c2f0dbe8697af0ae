"""Simulated sets with known stars for the tests of matching: names taken away or changed, and how many come back."""

from dataclasses import dataclass, replace

import numpy as np

from boresight.calibration.matching.rematch import Matches, Rematcher, ground_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

SENSORS = (1, 2, 3, 4, 5, 6)


@dataclass(frozen=True)
class Sky:
    telemetry: Telemetry
    sensor: Sensor
    catalogue: object
    x: np.ndarray
    P: np.ndarray

    @property
    def true(self):
        return self.telemetry.star_id

    def blanked(self, share, seed=7):
        gone = np.random.default_rng(seed).random(len(self.true)) < share
        return replace(self.telemetry, star_id=np.where(gone, 0, self.true), quaternion=None)

    def match(self, telemetry, folder=None, **settings) -> Matches:
        chosen = CalibrationSettings(**settings)
        return Rematcher(telemetry, self.sensor, self.catalogue, chosen, folder)(self.x, self.P)


def sky(catalogue, number=1, frames=40, seed=0, start="ground", **changes):
    scenario = replace(
        calibration_scenario(number, frames), **{"false_stars": 1.0, "blanked_share": 0.0, "seed": seed, **changes}
    )
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    sensor = st16_sensor(number)
    if start == "ground":
        return Sky(telemetry, sensor, catalogue, sensor.initial, ground_covariance(sensor, 10.0))
    return Sky(telemetry, sensor, catalogue, st16_truth(number), np.diag((0.1 * sensor.typical_sigma) ** 2))


@dataclass
class Score:
    sought: int = 0
    back: int = 0
    matched: int = 0
    wrong: int = 0
    frames: int = 0
    solved: int = 0

    def count(self, matches, telemetry, true):
        sought = (true > 0) & (telemetry.star_id != true)
        self.sought += sought.sum()
        self.back += (sought & (matches.star_id == true)).sum()
        self.matched += (matches.star_id > 0).sum()
        self.wrong += ((matches.star_id > 0) & (matches.star_id != true)).sum()
        first = np.unique(matches.frame, return_index=True)[1]
        self.frames += len(first)
        self.solved += np.logical_or.reduceat(matches.valid, first).sum()

    @property
    def recovered(self):
        return self.back / self.sought

    @property
    def wrong_share(self):
        return self.wrong / self.matched
