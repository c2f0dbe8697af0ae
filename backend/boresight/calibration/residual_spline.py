"""The residual spline as a part of a calibration: what a camera leaves over, whether that is noise, and who explains it.

Here it is put into the form of a calibration and read from it;
`trust.residual_spline` finds it, `estimation.residual_spline` derives it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import (
    LargestDisplacement,
    ResidualSpline,
    SplineCoefficients,
    SplineExplanation,
    SplineTest,
    parse_part,
)
from boresight.errors import RefusedInputError
from boresight.estimation.residual_spline import DEGREE, Axis, Surface

#: Chance of a claim where the model is right.
FALSE_ALARM = 0.01
#: Decimals of displacements, pixels.
DECIMALS = 7


@dataclass(frozen=True)
class ResidualSplineFit:
    """What a camera model leaves over after its fit.

    Parameters
    ----------
    surface
        Displacement of row and column over the detector, pixels: a star's centroid less where the camera at the estimate puts it,
        less what rotations of the sky and the free parameters could take up.
    row_px, col_px
        (n,), (m,) places at which it is told.
    displacement_px, sigma_px
        (2, n, m) along row and column there, and one sigma.
    strength_px
        Root mean square displacement that the evidence favours.
    effective
        Degrees of freedom that the surface takes.
    noise
        Noise over the stated centroid noise, at least one; sigmas are widened by it.
    statistic, expected, p
        Of the test: its value, its mean where the model is right, the chance of as much then.
    largest
        Where most is displaced.
    at_most_px
        Upper end of the 95 % band of an axis, over the whole detector.
    explained_by
        Camera models asked, those with the fewest parameters first; empty where nothing was found.
    stars, frames, left_out
        Sightings that took part, frames, and sightings taken for wrong matches.
    camera_model, sentence
        The camera that leaves it; value, sigma, probability and what to do, for a person.
    """

    surface: Surface
    row_px: FloatArray
    col_px: FloatArray
    displacement_px: FloatArray
    sigma_px: FloatArray
    strength_px: float
    effective: float
    noise: float
    statistic: float
    expected: float
    p: float
    largest: LargestDisplacement
    at_most_px: float
    explained_by: tuple[SplineExplanation, ...]
    stars: int
    frames: int
    left_out: int
    camera_model: str
    sentence: str

    @property
    def structure(self) -> bool:
        """Whether more is left than noise explains, at a false-alarm rate of `FALSE_ALARM`."""
        return self.p < FALSE_ALARM

    @property
    def remedy(self) -> SplineExplanation | None:
        """The least camera model that leaves nothing; None where none does, or nothing is left."""
        return next((one for one in self.explained_by if suffices(one)), None)

    def describe(self) -> ResidualSpline:
        """Write it as the part of a calibration."""
        row, col = self.surface.row, self.surface.col
        return ResidualSpline(
            camera_model=self.camera_model,
            degree=DEGREE,
            row_knots_px=row.knots.tolist(),
            col_knots_px=col.knots.tolist(),
            coefficients=SplineCoefficients(
                row_px=_rounded(self.surface.coefficients[0]), col_px=_rounded(self.surface.coefficients[1])
            ),
            row_px=self.row_px.tolist(),
            col_px=self.col_px.tolist(),
            d_row_px=_rounded(self.displacement_px[0]),
            d_col_px=_rounded(self.displacement_px[1]),
            sigma_row_px=_rounded(self.sigma_px[0]),
            sigma_col_px=_rounded(self.sigma_px[1]),
            strength_px=self.strength_px,
            effective_parameters=self.effective,
            noise=self.noise,
            test=SplineTest(statistic=self.statistic, expected=self.expected, p=self.p, false_alarm_rate=FALSE_ALARM),
            structure=self.structure,
            largest=self.largest,
            at_most_px=self.at_most_px,
            explained_by=list(self.explained_by),
            stars=self.stars,
            frames_used=self.frames,
            left_out=self.left_out,
            sentence=self.sentence,
        )


def _rounded(values: FloatArray) -> Any:
    """Nested lists without digits that mean nothing."""
    return np.round(values, DECIMALS).tolist()


def read_residual_spline(found: ResidualSpline) -> ResidualSplineFit:
    """Read what `ResidualSplineFit.describe` wrote."""
    return ResidualSplineFit(
        surface=Surface(
            _axis(np.array(found.row_knots_px)),
            _axis(np.array(found.col_knots_px)),
            np.array([found.coefficients.row_px, found.coefficients.col_px]),
        ),
        row_px=np.array(found.row_px),
        col_px=np.array(found.col_px),
        displacement_px=np.array([found.d_row_px, found.d_col_px], dtype=np.float64),
        sigma_px=np.array([found.sigma_row_px, found.sigma_col_px], dtype=np.float64),
        strength_px=found.strength_px,
        effective=found.effective_parameters,
        noise=found.noise,
        statistic=found.test.statistic,
        expected=found.test.expected,
        p=found.test.p,
        largest=found.largest,
        at_most_px=found.at_most_px,
        explained_by=tuple(found.explained_by),
        stars=found.stars,
        frames=found.frames_used,
        left_out=found.left_out,
        camera_model=found.camera_model,
        sentence=found.sentence,
    )


@dataclass(frozen=True, kw_only=True)
class _Trust:
    residual_spline: ResidualSpline | None = None


@dataclass(frozen=True, kw_only=True)
class _Document:
    """Where a parameter set's JSON has the spline, and where a calibration's has it."""

    residual_spline: ResidualSpline | None = None
    trust: _Trust | None = None


def find_in(document: Mapping[str, Any]) -> ResidualSplineFit | None:
    """Read the residual spline of a calibration's or a parameter set's JSON; None where there is none, or noise alone."""
    said = parse_part(_Document, document, RefusedInputError)
    found = said.residual_spline or (said.trust.residual_spline if said.trust else None)
    spline = None if found is None else read_residual_spline(found)
    return spline if spline is not None and spline.structure else None


def require_in(document: Mapping[str, Any], name: str) -> ResidualSplineFit:
    """Read the residual spline of a document; refuse where there is none to be followed. `name`: what the refusal calls it."""
    spline = find_in(document)
    if spline is None:
        raise RefusedInputError(
            f"{name} has no residual spline beyond its noise: leave out --residual, or give the calibration that "
            "`boresight calibrate --json` wrote.",
            code="no-residual-spline",
        )
    return spline


def suffices(explanation: SplineExplanation) -> bool:
    """Whether a camera model leaves nothing that noise does not explain."""
    return explanation.p >= FALSE_ALARM


def _axis(knots: FloatArray) -> Axis:
    """Splines of an axis from their knots."""
    cells = len(knots) - 2 * DEGREE - 1
    return Axis(round(float(knots[-1 - DEGREE] - knots[DEGREE])), cells)
