"""The built-in profiles, one for each program whose files are known: each says where its conventions are written.

Pixels: astrometry.net and SExtractor call the centre of the first pixel 1 (FITS), tetra3 and cedar 0.5, photutils and OpenCV 0,
tetra3rs counts from the middle. `row` is the coordinate that grows down the stored image: y of an array, whatever a viewer shows.
The exports of Yamcs and OpenC3 COSMOS have a mission's own names; these two profiles read items called STAR1_ROW, STAR1_COL, ...
and are written to be copied: `boresight import --profile yamcs --print-profile`.
"""

from __future__ import annotations

import math
from typing import Final

from boresight.telemetry.imports.profile import (
    Axis,
    Directions,
    Frames,
    Layout,
    Magnitude,
    Profile,
    Quantity,
    Quaternion,
    Sigma,
    StarId,
    Temperature,
    Time,
    Velocity,
    Wide,
)

_CONTRACT: Final[tuple[Quantity, ...]] = (
    "time",
    "star_id",
    "directions",
    "quaternion",
    "velocity",
    "magnitude",
    "sigma",
    "temperature",
)
_HALF: Final = math.sqrt(0.5)
#: From a camera's frame (x right along the columns, y down, z out) to the triad of an upright detector, parity -1: (y, -x, z).
_UPRIGHT: Final = (0.0, 0.0, -_HALF, _HALF)
_FITS_TIME = Time(keyword="DATE-OBS")


def _wide(name: str, description: str, layout: Layout, time: Time) -> Profile:
    """Return the profile of an export of a control system: a row a packet, its stars beside one another."""
    return Profile(
        name=name,
        description=description,
        layout=layout,
        wide=Wide(count=100),
        frames=Frames(by="record"),
        row=Axis(column="STAR{n}_ROW"),
        col=Axis(column="STAR{n}_COL"),
        time=time,
        magnitude=Magnitude(column="STAR{n}_MAG"),
        star_id=StarId(column="STAR{n}_ID"),
        quaternion=Quaternion(columns=("Q_X", "Q_Y", "Q_Z", "Q_W")),
        temperature=Temperature(column="TEMPERATURE"),
        optional=("magnitude", "star_id", "quaternion", "temperature"),
    )


def _sextractor(name: str, description: str, x: str, y: str, variances: tuple[str, str]) -> Profile:
    return Profile(
        name=name,
        description=description,
        frames=Frames(by="file"),
        row=Axis(column=y, origin=1.0),
        col=Axis(column=x, origin=1.0),
        time=_FITS_TIME,
        magnitude=Magnitude(column="MAG_AUTO|MAG_ISO|MAG_BEST"),
        sigma=Sigma(columns=variances, kind="variance"),
        optional=("magnitude", "sigma"),
    )


_PROFILES = (
    Profile(
        name="contract",
        description="Telemetry's own columns, in any table: FITS, VOTable, ECSV, CSV, JSON Lines or Parquet.",
        frames=Frames(column="frame", exposure="exposure"),
        row=Axis(column="row_px"),
        col=Axis(column="col_px"),
        time=Time(column="time_utc"),
        star_id=StarId(column="star_id"),
        directions=Directions(ra="ra_deg", dec="dec_deg"),
        quaternion=Quaternion(columns=("q_x", "q_y", "q_z", "q_w")),
        velocity=Velocity(columns=("vx_km_s", "vy_km_s", "vz_km_s")),
        magnitude=Magnitude(column="magnitude"),
        sigma=Sigma(columns=("sigma_px",)),
        temperature=Temperature(column="temperature_c"),
        optional=_CONTRACT,
    ),
    Profile(
        name="packets",
        description="Centroids and quaternions in separate packets: each row has one or the other; they are joined by time.",
        frames=Frames(by="time"),
        row=Axis(column="row_px"),
        col=Axis(column="col_px"),
        time=Time(column="time_utc"),
        magnitude=Magnitude(column="magnitude"),
        quaternion=Quaternion(columns=("q_x", "q_y", "q_z", "q_w")),
        optional=("magnitude", "quaternion"),
    ),
    Profile(
        name="astrometry-xyls",
        description="Sources of one image as astrometry.net lists them (.xyls): FITS pixels.",
        layout=Layout(format="fits"),
        frames=Frames(by="file"),
        row=Axis(column="Y|YIMAGE", origin=1.0),
        col=Axis(column="X|XIMAGE", origin=1.0),
        time=_FITS_TIME,
        magnitude=Magnitude(column="FLUX", kind="flux"),
        optional=("magnitude",),
    ),
    Profile(
        name="astrometry-axy",
        description="Sources of one image as astrometry.net's solver takes them (.axy): FITS pixels, the image's header.",
        layout=Layout(format="fits"),
        frames=Frames(by="file"),
        row=Axis(column="Y", origin=1.0),
        col=Axis(column="X", origin=1.0),
        time=_FITS_TIME,
        magnitude=Magnitude(column="FLUX", kind="flux"),
        optional=("magnitude",),
    ),
    Profile(
        name="astrometry-corr",
        description="Stars that astrometry.net matched in one image (.corr): FITS pixels, positions of its index (J2000).",
        frames=Frames(by="file"),
        row=Axis(column="field_y", origin=1.0),
        col=Axis(column="field_x", origin=1.0),
        time=_FITS_TIME,
        directions=Directions(ra="index_ra", dec="index_dec", kind="catalogue"),
        magnitude=Magnitude(column="FLUX", kind="flux"),
        optional=("magnitude",),
    ),
    _sextractor(
        "sextractor", "A SExtractor catalogue (ASCII_HEAD, FITS_LDAC or FITS_1.0) by its isophotal positions.",
        "X_IMAGE", "Y_IMAGE", ("ERRX2_IMAGE", "ERRY2_IMAGE"),
    ),
    _sextractor(
        "sextractor-win", "A SExtractor catalogue, using windowed positions (more accurate).",
        "XWIN_IMAGE", "YWIN_IMAGE", ("ERRX2WIN_IMAGE", "ERRY2WIN_IMAGE"),
    ),
    Profile(
        name="photutils",
        description="A table of photutils' star finders, catalogue or photometry, as ECSV, FITS or CSV.",
        frames=Frames(by="file"),
        row=Axis(column="y_centroid|ycentroid|y_fit"),
        col=Axis(column="x_centroid|xcentroid|x_fit"),
        magnitude=Magnitude(column="flux|segment_flux|flux_fit", kind="flux"),
        sigma=Sigma(columns=("x_err", "y_err")),
        optional=("magnitude", "sigma"),
    ),
    Profile(
        name="tetra3",
        description="Solutions of tetra3 or cedar-solve with return_matches, as JSON: one object per solved image.",
        layout=Layout(format="json", explode=("matched_centroids", "matched_stars", "matched_catID")),
        frames=Frames(by="record"),
        row=Axis(column="matched_centroids.1", origin=0.5),
        col=Axis(column="matched_centroids.2", origin=0.5),
        time=Time(column="time"),
        star_id=StarId(column="matched_catID"),
        directions=Directions(ra="matched_stars.1", dec="matched_stars.2", kind="catalogue"),
        magnitude=Magnitude(column="matched_stars.3"),
        optional=("time", "star_id"),
    ),
    Profile(
        name="tetra3rs",
        description="Centroids and solutions of tetra3rs as JSON: x and y measured from the image centre; give the sensor for its "
        "size.",
        layout=Layout(format="json", explode=("centroids",), indexed={"matched_catalog_ids": "matched_centroids"}),
        frames=Frames(by="record"),
        row=Axis(column="centroids.2|centroids.y", origin="centre"),
        col=Axis(column="centroids.1|centroids.x", origin="centre"),
        time=Time(column="time"),
        magnitude=Magnitude(column="centroids.3|centroids.brightness", kind="flux"),
        quaternion=Quaternion(
            columns=("quaternion.1", "quaternion.2", "quaternion.3", "quaternion.4"), order="wxyz", mounting=_UPRIGHT
        ),
        optional=("time", "magnitude", "quaternion"),
    ),
    Profile(
        name="openstartracker",
        description="Lines of openstartracker: x, y and magnitude of every star of an image, measured from the centre of the "
        "corner pixel.",
        layout=Layout(format="ragged", cells_per_star=3),
        frames=Frames(by="record"),
        row=Axis(column="2"),
        col=Axis(column="1"),
        magnitude=Magnitude(column="3"),
    ),
    _wide(
        "yamcs", "Parameters that Yamcs exports as tab-separated values; copy it and enter your parameters' names.",
        Layout(format="text", separator="tab"), Time(column="Time"),
    ),
    _wide(
        "openc3", "Items that the Data Extractor of OpenC3 COSMOS writes as CSV; copy it and enter your items' names.",
        Layout(), Time(column="TIME"),
    ),
)  # fmt: skip
BUILT_IN: Final = {profile.name: profile for profile in _PROFILES}
