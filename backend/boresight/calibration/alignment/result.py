"""An alignment as a tree of frozen dataclasses, and its JSON, `boresight.alignment/1`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.advice_kinds import join_codes
from boresight.calibration.alignment.sides import Knowledge
from boresight.calibration.calibration import Matrix, Numbers, make_schema, parse_part
from boresight.errors import RefusedInputError
from boresight.estimation.alignment import TERMS, Kind
from boresight.estimation.attitude import product, to_quaternion, vector_to_quaternion

SCHEMA: Final = "boresight.alignment/1"
AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class AlignedSide:
    """One of the two frames: whose it is, how many exposures had an attitude, and where its camera's covariance comes from.

    `values`: the parameters that its attitudes were solved with, SI; empty of a reference.
    """

    name: str
    parameters: Knowledge
    values: dict[str, float] = field(default_factory=dict)
    exposures: int
    attitudes: int
    start_utc: str
    end_utc: str


@dataclass(frozen=True, kw_only=True)
class AlignmentTerm:
    """What the rotation depends on: arcsec a `unit` about the axes of B, with one sigma (with misfit)."""

    name: str
    kind: Kind
    power: int
    unit: str
    value_arcsec: list[float]
    sigma_arcsec: list[float]


@dataclass(frozen=True, kw_only=True)
class AlignmentTermTest:
    """Fall of chi-square with a term, three degrees of freedom, and its chance where the term is not there."""

    name: str
    fall: float
    p: float
    needed: bool

    @property
    def kind(self) -> Kind | None:
        """What the term is a power of; None for one that this version does not know."""
        return TERMS[self.name].kind if self.name in TERMS else None


@dataclass(frozen=True, kw_only=True)
class PairTest:
    """Chi-square of the pairs over its degrees of freedom, and the 95 % bounds of sound pairs."""

    chi2: float
    dof: int
    ratio: float | None
    lower: float | None
    upper: float | None


@dataclass(frozen=True, kw_only=True)
class RemovedPair:
    """A pair that was left out: when, of which exposures, how far it is off, and the chance of that."""

    time_utc: str
    frame_a: int | None
    exposure_a: int | None
    frame_b: int | None
    exposure_b: int | None
    angle_arcsec: float
    chi2: float
    probability: float


@dataclass(frozen=True, kw_only=True)
class PairResiduals:
    """Residual angles of the pairs about the axes of B, one entry a pair: arcsec, with one sigma of its own, and its chance.

    The cameras' error as the pairs tell it is taken off, and is not in the sigmas: it is the same in all of them.
    `variation_arcsec`: what the terms give at the pair, so that residual and variation together are the pair's own angles.
    """

    time_utc: list[str] = field(default_factory=list)
    temperature_c: Numbers = field(default_factory=list)
    residual_arcsec: list[list[float]] = field(default_factory=list)
    sigma_arcsec: list[list[float]] = field(default_factory=list)
    variation_arcsec: list[list[float]] = field(default_factory=list)
    probability: list[float] = field(default_factory=list)
    kept: list[bool] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class RotationToLoad:
    """The rotation between the attitudes that are reported with these very parameters: C_SD to be loaded with them.

    As in `Alignment`, its sigmas and covariance with the scatter of the pairs and without the error that the cameras keep on board.
    `terms_arcsec`: of each term, about x, y, z of B.
    """

    quaternion: list[float]
    matrix: Matrix
    sigma_arcsec: list[float]
    covariance_rad2: Matrix
    terms_arcsec: list[list[float]]


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """The rotation from A to B, C_ba, at `reference_temperature_c` and `reference_utc`; C_SD where B is the frame S.

    `quaternion`: x y z w, Hamilton, it turns vectors of A into vectors of B. `matrix`: the same. `to_load`: what goes on board with
    these very parameters. Sigmas and covariances are of small turns about the axes of B: `sigma_arcsec` of noise and cameras,
    `sigma_with_misfit_arcsec` with the scatter of the pairs too. `covariance_rad2`: with misfit, over the three angles and then
    three of each term, in the units of the terms.
    """

    schema: Literal["boresight.alignment/1"] = SCHEMA
    a: AlignedSide
    b: AlignedSide
    quaternion: list[float]
    matrix: Matrix
    sigma_arcsec: list[float]
    sigma_with_misfit_arcsec: list[float]
    covariance_rad2: Matrix
    to_load: RotationToLoad
    reference_temperature_c: float | None
    temperature_of: str | None
    temperature_range_c: list[float] | None
    reference_utc: str
    terms: list[AlignmentTerm]
    tests: list[AlignmentTermTest]
    pairs: int
    pairs_used: int
    interpolated: int
    test: PairTest
    removed: list[RemovedPair]
    residuals: PairResiduals
    sentence: str
    advice: list[str]
    advice_codes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Put what was read of the advice beside its codes."""
        join_codes(self)

    def at(self, temperature_c: float | None = None, days: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return quaternion (4,) and covariance (3, 3), rad², at a temperature and so many days from `reference_utc`."""
        values = [1.0]
        for term in self.terms:
            away = days
            if term.kind == "temperature":
                about = self.reference_temperature_c or 0.0
                away = 0.0 if temperature_c is None else temperature_c - about
            values.append(away**term.power)
        angles = sum(
            (value * np.array(term.value_arcsec) for value, term in zip(values[1:], self.terms, strict=True)),
            np.zeros(3),
        )
        E = np.kron(values, np.eye(3))
        P = E @ np.array(self.covariance_rad2, np.float64) @ E.T
        return product(vector_to_quaternion(angles / ARCSEC_PER_RAD), np.array(self.quaternion)), P

    @property
    def c_sd(self) -> FloatArray:
        """(3, 3) the matrix as an array."""
        return np.array(self.matrix, np.float64)


def parse_alignment(document: Mapping[str, Any], name: str = "This document") -> Alignment:
    """Read an alignment from its JSON."""
    if document.get("schema") != SCHEMA:
        raise RefusedInputError(f"{name} is not an alignment: give the JSON file written by `boresight align`.")
    return parse_part(Alignment, document, lambda fault: RefusedInputError(f"{name}: {fault}: write it again."))


#: Relative difference of parameters that rounding in files explains.
_SAME = 1e-9


def check_loaded(found: Alignment, sensor: str, values: Mapping[str, float]) -> None:
    """Refuse an alignment of another sensor or made with other parameters: its numbers would turn the attitude wrongly."""
    if found.a.name != sensor:
        raise RefusedInputError(
            f"The alignment starts at {found.a.name}, not at {sensor}: give one whose tracker A is {sensor}."
        )
    for name, value in values.items():
        known = found.a.values.get(name, np.nan)
        if not abs(known - value) <= _SAME * max(abs(value), 1e-12):
            raise RefusedInputError(
                f"The alignment was made with {name} = {known:.9g}, and {value:.9g} is to be loaded: align again with these "
                "parameters."
            )


def compute_json_schema() -> dict[str, Any]:
    """Return the JSON Schema of the alignment JSON."""
    return make_schema(Alignment, SCHEMA)


def write_quaternion(matrix: FloatArray) -> list[float]:
    """Write a rotation (3, 3) as x, y, z, w."""
    return [float(one) for one in to_quaternion(matrix)]
