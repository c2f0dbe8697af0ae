"""Every candidate fitted to the same whitened arcs, so that differences of chi-square mean something.

Differences of chi-square are chi-square distributed, and BIC comparable, only where all candidates are fitted to the same data with
the same weights. A star's direction error depends a little on the camera (`estimation.arcs`), so the catalogue arcs and the factor
of R are filled once, at one state, and every candidate gets them with its own camera.

What is not free rests: tilt, decentring, aspect and radial terms at nothing, the principal point where the sensor file has it. So a
test asks whether a lens has a term at all, and its answer does not depend on what the sensor file begins with.

Of many subsets one need not fit all. Where a candidate is determined, with covariance P, and its terms W are held at rest, d from
where it has them, the linearised chi-square rises by d_W^T (P_WW)^-1 d_W (Wald). Far away that is not exact, so a candidate is
*rejected* so only where its rise is many times what a test takes, and with it all that it contains, which are worse still; all
others are fitted.

A candidate begins where the best of those it contains ended, so a larger one is never worse than a smaller one, and takes a few
iterations. One whose free parameters the stars cannot tell apart is *undetermined*: in units in which each alone has the sigma 1,
A has an eigenvalue below `LEAST_SHARE`, a direction ten thousand times less certain than its parts. Such a candidate is said, and
never chosen; its chi-square still shows what the camera can do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.choice.result import State
from boresight.calibration.choice.terms import Subset, list_subsets
from boresight.calibration.estimate import never
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.metrics import rms
from boresight.telemetry.sensors import Sensor

#: Eigenvalue of A with a unit diagonal below which a direction is not told apart from nothing.
LEAST_SHARE = 1e-8
MAX_ITERATIONS = 60
#: States of candidates that were fitted.
FITTED = frozenset({State.DETERMINED, State.UNDETERMINED, State.IMPLAUSIBLE})
#: Chi-square by which a larger candidate may be above one that it contains before it is fitted again from there.
ROUNDING = 1e-6


@dataclass(frozen=True)
class FittedSubset:
    """A candidate with its fit.

    `subset`: camera and free terms. `x`: (n_parameters,) SI. `P`: (n_free, n_free) covariance by the stated noise, SI. `chi2`,
    `dof`: whitened sum of squares, and arcs less free parameters. `rms_arc_rad`: unweighted. `state`: whether it can be chosen.
    """

    subset: Subset
    x: FloatArray
    P: FloatArray
    chi2: float
    dof: int
    rms_arc_rad: float
    state: State

    @property
    def usable(self) -> bool:
        """Whether it can be chosen."""
        return self.state is State.DETERMINED

    @property
    def n_free(self) -> int:
        """Number of free parameters."""
        return len(self.P)

    @property
    def camera(self) -> CameraModel:
        """Its camera."""
        return self.subset.camera


def seen_by(arcs: ArcSet, camera: CameraModel) -> ArcSet:
    """Give whitened arcs to another camera: the same stars, catalogue arcs and weights."""
    return ArcSet(**{**vars(arcs), "camera": camera})


def whitened_at(arcs: ArcSet, camera: CameraModel, x: FloatArray) -> ArcSet:
    """Fill catalogue arcs and weights at the state x of a camera, which may be another than that of the arcs."""
    of_camera = seen_by(arcs, camera)
    return arcsets.whiten(of_camera, arcsets.angular_sigma(camera, x, of_camera))[0]


@dataclass
class Fits:
    """The candidates that were fitted so far, on one set of whitened arcs."""

    arcs: ArcSet
    sensor: Sensor
    cancelled: Callable[[], bool] = never
    known: dict[tuple[str, tuple[str, ...]], FittedSubset] = field(default_factory=dict)

    def fit(self, subset: Subset, begin: FloatArray | None = None) -> FittedSubset:
        """Fit a candidate once; it begins at the best of those within it, or at `begin`, or as a lens without distortion."""
        key = subset.camera.name, subset.term_names
        if key not in self.known or self.known[key].state is State.REJECTED:
            within = [one for one in self.known.values() if subset.contains(one.subset) and one.state in FITTED]
            best = min(within, key=lambda one: one.chi2, default=None)
            x = begin if begin is not None else best.x if best is not None else self.plain(subset.camera)
            self.known[key] = self._fitted(subset, x)
        return self.known[key]

    def fit_all(self, camera: CameraModel, hopeless: Callable[[Subset, Subset, float], bool]) -> None:
        """Fit every subset of a camera's terms, larger ones first, but those that `hopeless` rejects by how much chi-square rises.

        It is asked of a subset, one that contains it, and the rise between them.
        """
        for subset in reversed(list_subsets(camera)):
            if (camera.name, subset.term_names) in self.known:
                continue
            above = [one for one in self.list_fitted(camera) if one.subset.contains(subset)]
            nearest = min((one for one in above if one.usable), key=lambda one: one.n_free, default=None)
            if nearest is not None:
                rise = self.rise(nearest, subset)
                if any(one.state is State.REJECTED for one in above) or hopeless(subset, nearest.subset, rise):
                    self.known[camera.name, subset.term_names] = self._rejected(subset, nearest.chi2 + rise)
                    continue
            self.fit(subset)
        self._begin_again(camera)

    def rise(self, larger: FittedSubset, subset: Subset) -> float:
        """Rise of the linearised chi-square where the terms that a determined candidate has more than a subset rest."""
        at = np.flatnonzero(~np.isin(larger.subset.free, subset.free))
        places = larger.subset.free[at]
        d = larger.x[places] - self.plain(larger.camera)[places]
        size = np.sqrt(np.diag(larger.P)[at])
        correlation = larger.P[np.ix_(at, at)] / np.outer(size, size)
        return float(d / size @ np.linalg.solve(correlation, d / size))

    def _rejected(self, subset: Subset, chi2: float) -> FittedSubset:
        n = len(subset.free)
        x, P = np.full(len(subset.camera.parameters), np.nan), np.full((n, n), np.nan)
        return FittedSubset(subset, x, P, chi2, self.arcs.n_arcs - n, np.nan, State.REJECTED)

    def _begin_again(self, camera: CameraModel) -> None:
        """Fit those again that ended above one that they contain."""
        for smaller in sorted(self.list_fitted(camera), key=lambda one: one.n_free):
            for larger in self.list_fitted(camera):
                if (
                    smaller.state in FITTED
                    and larger.subset.contains(smaller.subset)
                    and larger.chi2 > smaller.chi2 + ROUNDING
                    and larger.state in FITTED
                ):
                    again = self._fitted(larger.subset, smaller.x)
                    if again.chi2 < larger.chi2:
                        self.known[camera.name, larger.subset.term_names] = again

    def list_fitted(self, camera: CameraModel) -> list[FittedSubset]:
        """Return the candidates of a camera, in the order in which they were looked at."""
        return [one for one in self.known.values() if one.camera is camera]

    def plain(self, camera: CameraModel) -> FloatArray:
        """State (n_parameters,) of a lens without distortion, with the sensor file's focal length and principal point."""
        own, x, pitch = CAMERA_MODELS[self.sensor.camera_model], self.sensor.initial, self.sensor.pixel_pitch_m
        return camera.plain(own.focal_px(x, pitch), *own.principal_point(x), pitch)

    def scale(self, camera: CameraModel) -> FloatArray:
        """Typical sigmas (n_parameters,) of a camera: the sensor file's of its own, of others those of their file."""
        if camera.name == self.sensor.camera_model:
            return self.sensor.typical_sigma
        return np.array(camera.default_typical_sigma)

    def _fitted(self, subset: Subset, begin: FloatArray) -> FittedSubset:
        camera, free = subset.camera, subset.free
        scale = self.scale(camera)[free]
        arcs = seen_by(self.arcs, camera)
        found = batch.fit(arcs, begin, free, scale, max_iterations=MAX_ITERATIONS, cancelled=self.cancelled)
        ended = found.status in {"converged", "rank_deficient", "max_iterations"}
        P = _covariance(found.A) if ended else None
        return FittedSubset(
            subset=subset,
            x=found.x,
            P=np.full((len(free), len(free)), np.nan) if P is None else P * np.outer(scale, scale),
            chi2=found.chi2 if ended else np.inf,
            dof=arcs.n_arcs - len(free),
            rms_arc_rad=rms(arcs, found.x) if ended else np.nan,
            state=self._state(camera, found, determined=P is not None),
        )

    def _state(self, camera: CameraModel, found: batch.BatchFit, *, determined: bool) -> State:
        """Say whether a fit can be chosen, and if not, why."""
        if found.status not in {"converged", "rank_deficient", "max_iterations"} or not np.isfinite(found.x).all():
            return State.FAILED
        low, high = np.array(camera.plausible).T
        sensor = self.sensor
        if not np.all((low <= found.x) & (found.x <= high)) or (
            camera.blind_corner(found.x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) is not None
        ):
            return State.IMPLAUSIBLE
        return State.DETERMINED if determined and found.status == "converged" else State.UNDETERMINED


def _covariance(A: FloatArray) -> FloatArray | None:
    """Invert the information, scaled to a unit diagonal first; None where a direction is not determined."""
    size = np.sqrt(np.diag(A))
    if not np.isfinite(A).all() or not (size > 0).all():
        return None
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    if values[0] < LEAST_SHARE:
        return None
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))
