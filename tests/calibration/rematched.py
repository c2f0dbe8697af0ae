"""Simulated sets with known stars for the tests of matching: names taken away or changed, and how many come back."""

from __future__ import annotations

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
    """A set in which every true star is named, and under what it is matched."""

    telemetry: Telemetry
    sensor: Sensor
    catalogue: object
    x: np.ndarray
    P: np.ndarray

    @property
    def true(self):
        """(n_rows,) true stars, 0 = false."""
        return self.telemetry.star_id

    def blanked(self, share, seed=7):
        """The set with a share of its names and all quaternions taken away."""
        gone = np.random.default_rng(seed).random(len(self.true)) < share
        return replace(self.telemetry, star_id=np.where(gone, 0, self.true), quaternion=None)

    def match(self, telemetry, folder=None, **settings) -> Matches:
        """Match a set of this sensor."""
        chosen = CalibrationSettings(**settings)
        return Rematcher(telemetry, self.sensor, self.catalogue, chosen, folder)(self.x, self.P)


def sky(catalogue, number=1, frames=40, seed=0, start="ground", **changes):
    """Simulate a set of an ST-16 with one false star an exposure, to be matched from its ground calibration or refined."""
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
    """Counts over sets: true stars that had no right name, those found; all matches, the wrong ones; frames and those solved."""

    sought: int = 0
    back: int = 0
    matched: int = 0
    wrong: int = 0
    frames: int = 0
    solved: int = 0

    def count(self, matches, telemetry, true):
        """Add a set that was matched from this telemetry."""
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
        """Share of the sought stars that were found."""
        return self.back / self.sought

    @property
    def wrong_share(self):
        """Share of the matches that are wrong."""
        return self.wrong / self.matched
