"""Frames of a run: in a list, and one with every star."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from boresight.api.schemas.row import Row


class FrameLine(Row):
    """A frame in a list."""

    id: int = Field(description="Its place in this list, from 1.")
    frame: int = Field(description="Its number in the telemetry.")
    detections: int
    chi2_per_dof: float | None = Field(description="Of the run's best fit; null where the result does not keep it.")
    deviation: float | None = Field(description="The same as a normal deviate: above 3 is bad.")


class StarUnder(BaseModel):
    """Where a parameter set puts a star, and what is left over; pairs are row, column."""

    model_config = ConfigDict(extra="forbid")
    row_px: float
    col_px: float
    d_px: list[float] = Field(description="Measured minus predicted.")
    sigma_px: list[float] = Field(description="Of the residual, from centroid noise.")
    d_arcsec: list[float]
    sigma_arcsec: list[float]
    apart_arcsec: float = Field(description="Angle between measured and predicted direction.")
    normalised: list[float] = Field(description="Residual over its sigma.")


class FrameStar(BaseModel):
    """A detection and what became of it."""

    model_config = ConfigDict(extra="forbid")
    row: int = Field(description="Its row in the frame, from 0.")
    row_px: float
    col_px: float
    sigma_px: float
    magnitude: float | None = Field(description="As the telemetry gives it.")
    star_id: int | None = Field(description="Hipparcos number it is matched with.")
    catalogue_magnitude: float | None = Field(description="Hp of the matched or named star.")
    given_star_id: int | None = Field(description="As the file names it.")
    old_star_id: int | None = Field(description="As matched under the old parameters.")
    fate: str = Field(description="`used`, `left out`, `rejected` or `unmatched`.")
    reason: str | None
    flags: list[str]
    old: StarUnder | None
    new: StarUnder | None


class FrameAttitude(BaseModel):
    """An exposure's attitude at one parameter set. Triad: x = increasing rows, z = boresight, right-handed."""

    model_config = ConfigDict(extra="forbid")
    quaternion: list[float] = Field(description="x y z w, Hamilton, ICRS to the detector triad.")
    ra_deg: float
    dec_deg: float
    roll_deg: float = Field(description="Position angle of increasing rows, from north through east.")
    covariance_rad2: list[list[float]] = Field(description="About x, y, z of the triad, from centroid noise.")
    sigma_arcsec: list[float]
    stars: int
    rms_px: float
    chi2: float
    dof: int
    worst_row: int | None = Field(description="Star with the largest normalised residual.")
    from_telemetry_arcsec: list[float] | None = Field(
        description="Turn about x, y, z from the quaternion that the telemetry gives to this one."
    )


class BothAttitudes(BaseModel):
    """Under the old and the new parameters; null where there is none."""

    model_config = ConfigDict(extra="forbid")
    old: FrameAttitude | None
    new: FrameAttitude | None


class UndetectedStar(BaseModel):
    """A catalogue star that lies on the detector and was not detected."""

    model_config = ConfigDict(extra="forbid")
    star_id: int
    magnitude: float
    row_px: float
    col_px: float


class FrameExposure(BaseModel):
    """One image of a frame."""

    model_config = ConfigDict(extra="forbid")
    exposure: int
    time_utc: str | None
    detections: int
    matched: int
    used: int = Field(description="Of them in the fit.")
    start: str = Field(description="Where matching began.")
    why_invalid: str | None = Field(description="Why matching does not call it valid.")
    why_no_attitude: str | None
    attitude: BothAttitudes
    stars: list[FrameStar]
    undetected: list[UndetectedStar]


class RunFrame(BaseModel):
    """One frame of a run under its old and new parameters, computed for this answer."""

    model_config = ConfigDict(extra="forbid")
    run: int
    sensor: str
    method: str
    place: int = Field(description="Among the frames of the set, from 1.")
    frames: int
    previous: int | None
    next: int | None
    rows: int
    columns: int
    partial: bool = Field(description="Whether the new parameters are those of a run that still computes.")
    frame: int
    time_utc: str | None
    temperature_c: float | None
    match: str
    why_no_new: str | None
    why_nothing: str | None
    exposures: list[FrameExposure]
