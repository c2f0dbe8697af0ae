"""A parameter set's document, `boresight.parameter-set/1`: what is kept of a calibration, or declared of a ground calibration.

It is immutable and known by the SHA-256 of its JSON, so its bytes are written once, by `console.parameter_sets`; here it is read.
Parts that packages repeat word for word stay as they are written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.calibration.advice_kinds import Advice, with_codes
from boresight.calibration.calibration import ModelMisfit, ResidualSpline, Values, parse_part
from boresight.errors import RefusedInputError


@dataclass(frozen=True, kw_only=True)
class ParameterSetDocument:
    """A parameter set, SI by parameter name; what a ground calibration or an older version did not have is None.

    `covariance`, `rms_arc_rad`, `alignment`, `inputs`: as the calibration's JSON says them.
    """

    camera_model: str
    parameters: Values[float]
    sigma: Values[float | None] | None = None
    covariance: dict[str, Any] | None = None
    sigma_with_misfit: Values[float | None] | None = None
    misfit: ModelMisfit | None = None
    free: list[str] | None = None
    method: str | None = None
    variant: str | None = None
    status: str | None = None
    advice: list[str] | None = None
    advice_codes: list[str] | None = None
    frames: int | None = None
    stars: int | None = None
    rms_arc_rad: dict[str, Any] | None = None
    chi2_per_dof: float | None = None
    alignment: dict[str, Any] | None = None
    inputs: dict[str, Any] | None = None
    residual_spline: ResidualSpline | None = None
    truth: Values[float] | None = None

    @property
    def coded_advice(self) -> list[Advice]:
        """The advice, each sentence with its kind."""
        return with_codes(self.advice or [], self.advice_codes or [])

    @property
    def reliable_sigma(self) -> Values[float | None]:
        """The sigmas to decide by: with misfit where that is known, else of noise alone."""
        return (self.sigma if self.misfit is None else self.sigma_with_misfit) or Values()


def parse_parameter_set(document: Mapping[str, Any]) -> ParameterSetDocument:
    """Read the document of a parameter set."""
    return parse_part(
        ParameterSetDocument,
        document,
        lambda fault: RefusedInputError(
            f"A parameter set's document is damaged ({fault}): restore the store from a backup.",
            code="damaged-document",
        ),
    )
