"""The residual spline as a part of a calibration: what a camera leaves over, whether that is noise, and who explains it.

It is written and read as JSON here; `trust.residual_spline` finds it, `estimation.residual_spline` derives it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation.residual_spline import DEGREE, Axis, Surface

#: Chance of a claim where the model is right.
FALSE_ALARM = 0.01
#: Decimals of displacements, pixels.
DECIMALS = 7


@dataclass(frozen=True)
class Explanation:
    """What a camera model with all its parameters free would leave: `p` of the same test, and the parameters it frees besides."""

    camera_model: str
    p: float
    more: tuple[str, ...]

    @property
    def suffices(self) -> bool:
        """Whether nothing is left that noise does not explain."""
        return self.p >= FALSE_ALARM


@dataclass(frozen=True)
class Largest:
    """The place of the largest displacement told: where, how much along either axis, its length and the sigma of that, pixels."""

    row_px: float
    col_px: float
    d_row_px: float
    d_col_px: float
    size_px: float
    sigma_px: float


@dataclass(frozen=True)
class ResidualSpline:
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
    largest: Largest
    at_most_px: float
    explained_by: tuple[Explanation, ...]
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
    def remedy(self) -> Explanation | None:
        """The least camera model that leaves nothing; None where none does, or nothing is left."""
        return next((one for one in self.explained_by if one.suffices), None)

    def document(self) -> dict[str, Any]:
        """Write it as JSON."""
        row, col = self.surface.row, self.surface.col
        return {
            "camera_model": self.camera_model,
            "degree": DEGREE,
            "row_knots_px": row.knots.tolist(),
            "col_knots_px": col.knots.tolist(),
            "coefficients": {
                "row_px": _rounded(self.surface.coefficients[0]),
                "col_px": _rounded(self.surface.coefficients[1]),
            },
            "row_px": self.row_px.tolist(),
            "col_px": self.col_px.tolist(),
            "d_row_px": _rounded(self.displacement_px[0]),
            "d_col_px": _rounded(self.displacement_px[1]),
            "sigma_row_px": _rounded(self.sigma_px[0]),
            "sigma_col_px": _rounded(self.sigma_px[1]),
            "strength_px": self.strength_px,
            "effective_parameters": self.effective,
            "noise": self.noise,
            "test": {
                "statistic": self.statistic,
                "expected": self.expected,
                "p": self.p,
                "false_alarm_rate": FALSE_ALARM,
            },
            "structure": self.structure,
            "largest": vars(self.largest),
            "at_most_px": self.at_most_px,
            "explained_by": [
                {"camera_model": one.camera_model, "p": one.p, "more": list(one.more)} for one in self.explained_by
            ],
            "stars": self.stars,
            "frames_used": self.frames,
            "left_out": self.left_out,
            "sentence": self.sentence,
        }


def _rounded(values: FloatArray) -> Any:
    """Nested lists without digits that mean nothing."""
    return np.round(values, DECIMALS).tolist()


def read_residual_spline(document: Mapping[str, Any]) -> ResidualSpline:
    """Read what `ResidualSpline.document` wrote."""
    row, col = (_axis(np.array(document[name])) for name in ("row_knots_px", "col_knots_px"))
    pair = [(f"{name}_row_px", f"{name}_col_px") for name in ("d", "sigma")]
    displacement, sigma = (np.array([document[name] for name in names], dtype=np.float64) for names in pair)
    test = document["test"]
    return ResidualSpline(
        surface=Surface(row, col, np.array([document["coefficients"][name] for name in ("row_px", "col_px")])),
        row_px=np.array(document["row_px"]),
        col_px=np.array(document["col_px"]),
        displacement_px=displacement,
        sigma_px=sigma,
        strength_px=document["strength_px"],
        effective=document["effective_parameters"],
        noise=document["noise"],
        statistic=test["statistic"],
        expected=test["expected"],
        p=test["p"],
        largest=Largest(**document["largest"]),
        at_most_px=document["at_most_px"],
        explained_by=tuple(
            Explanation(one["camera_model"], one["p"], tuple(one["more"])) for one in document["explained_by"]
        ),
        stars=document["stars"],
        frames=document["frames_used"],
        left_out=document["left_out"],
        camera_model=document["camera_model"],
        sentence=document["sentence"],
    )


def find_in(document: Mapping[str, Any]) -> ResidualSpline | None:
    """Read the residual spline of a calibration or of a parameter set; None where there is none, or nothing in it but noise."""
    found = document.get("residual_spline") or (document.get("trust") or {}).get("residual_spline")
    spline = None if not found else read_residual_spline(found)
    return spline if spline is not None and spline.structure else None


def _axis(knots: FloatArray) -> Axis:
    """Splines of an axis from their knots."""
    cells = len(knots) - 2 * DEGREE - 1
    return Axis(round(float(knots[-1 - DEGREE] - knots[DEGREE])), cells)
