"""What the study runs on each telemetry set: the paper's estimators, their peers, and the forms the paper argues about.

All start from the ground calibration with P_0 = (10 typical sigmas)^2, which the paper leaves unstated. Stars are matched anew by
the statistical rule, whose tolerance follows from the parameters' covariance; `-flight` takes in only what the flight software
would accept with its fixed tolerance, and from a ground calibration those are the arcs that agree with it. Filters take the
corrected equations (errata to E Eqs 83 to 88) and linearise a frame anew while its state still moves; `printed` linearises once
a frame, as printed. The paper's own EKF is that same filter in covariance form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from boresight.calibration.options import CalibrationSettings

#: E section III-B, from Samaan et al.
REDUCED = ("f_m", "m0_px", "n0_px")
#: The UKF that gets so many times fewer frames stands for a processor without the time for full rate (E section IV).
SPARSE_EVERY = 3

_MATCHED = CalibrationSettings(match="rematch")


@dataclass(frozen=True)
class Estimator:
    """One way to calibrate.

    Parameters
    ----------
    key
        In documents.
    label
        In tables.
    settings
        Of the calibration.
    every
        Takes each n-th frame only.
    start
        `ground`, or `batch` for a start at the batch's own result (E Figures 3b and 4).
    sensors
        Sensors it is run for.
    repeated
        Whether it is run on the further sets too, for its statistics.
    """

    key: str
    label: str
    settings: CalibrationSettings
    every: int = 1
    start: str = "ground"
    sensors: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    repeated: bool = True

    @property
    def reduced(self) -> bool:
        """Whether it leaves parameters at their ground values."""
        return self.settings.free is not None


_PAPERS = (
    Estimator("batch", "Batch", replace(_MATCHED, method="batch")),
    Estimator("q", "SQRF Q", replace(_MATCHED, method="sqrf", variant="q")),
    Estimator("no-q", "SQRF No-Q", replace(_MATCHED, method="sqrf", variant="no-q")),
    Estimator("no-refit", "SQRF No-Refit", replace(_MATCHED, method="sqrf", variant="no-refit")),
)
_PEERS = (
    Estimator("ekf", "EKF No-Q", replace(_MATCHED, method="ekf")),
    Estimator("ukf", "UKF No-Q", replace(_MATCHED, method="ukf")),
    Estimator("ukf-sparse", f"UKF, every {SPARSE_EVERY}rd frame", replace(_MATCHED, method="ukf"), SPARSE_EVERY),
    Estimator("printed", "SQRF No-Q, one linearisation", replace(_MATCHED, method="sqrf", linearisations=1)),
    Estimator("cosine", "Batch, cosine of arc", replace(_MATCHED, method="batch", error="cosine")),
)
_REDUCED = tuple(
    Estimator(f"reduced-{paper.key}", f"{paper.label}, f m₀ n₀", replace(paper.settings, free=REDUCED), repeated=False)
    for paper in _PAPERS
)
_FROM_BATCH = tuple(
    Estimator(f"{paper.key}-from-batch", f"{paper.label} from batch", paper.settings, 1, "batch", (4,), repeated=False)
    for paper in _PAPERS[1:]
)

_FLIGHT = tuple(
    Estimator(f"{paper.key}-flight", f"{paper.label}, flight rule", replace(paper.settings, match_rule="flight"))
    for paper in (_PAPERS[0], *_PAPERS[2:])
)

ESTIMATORS: dict[str, Estimator] = {
    estimator.key: estimator for estimator in (*_PAPERS, *_PEERS, *_FLIGHT, *_REDUCED, *_FROM_BATCH)
}


def estimators_for(sensor: int, *, further: bool) -> list[Estimator]:
    """Return what is run on a set of a sensor, the batch first; `further` sets leave out what needs no statistics."""
    return [
        estimator
        for estimator in ESTIMATORS.values()
        if sensor in estimator.sensors and (estimator.repeated or not further)
    ]
