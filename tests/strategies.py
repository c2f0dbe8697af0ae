"""One home for Hypothesis strategies: rotations, directions, sensors, telemetry tables."""

import numpy as np
import pyarrow as pa
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from boresight.cameras import CAMERA_MODELS
from boresight.telemetry.declarations import AXES, DECLARATIONS, GLOBAL, LINE_TIME_S, ROLLING, Declared, Readout
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Telemetry
from boresight.telemetry.sensors import Sensor

_FLOAT_OPTIONS = {"allow_nan": False, "allow_infinity": False, "width": 64}


def unit_vectors():
    components = npst.arrays(float, 3, elements=st.floats(-1.0, 1.0, **_FLOAT_OPTIONS))
    return components.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))


def rotations():
    components = npst.arrays(float, 4, elements=st.floats(-1.0, 1.0, **_FLOAT_OPTIONS))
    return components.filter(lambda q: np.linalg.norm(q) > 1e-3).map(_matrix_of_quaternion)


def _matrix_of_quaternion(quaternion):
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


@st.composite
def sensors(draw):
    model = CAMERA_MODELS[draw(st.sampled_from(sorted(CAMERA_MODELS)))]
    rows, columns = draw(st.integers(256, 4096)), draw(st.integers(256, 4096))
    pitch = draw(st.floats(2e-6, 2e-5, **_FLOAT_OPTIONS))
    focal_px = 0.5 * np.hypot(rows, columns) / np.tan(np.radians(draw(st.floats(2.0, 15.0, **_FLOAT_OPTIONS))))
    names = model.parameter_names
    free = draw(st.lists(st.sampled_from(names), min_size=1, unique=True))
    return Sensor(
        name=draw(st.text("abcXYZ019 -_é", min_size=1, max_size=20).filter(lambda text: text == text.strip())),
        rows=rows,
        columns=columns,
        pixel_pitch_m=pitch,
        camera_model=model.name,
        parity=draw(st.sampled_from([1, -1])),
        centroid_sigma_px=draw(st.floats(0.01, 2.0, **_FLOAT_OPTIONS)),
        initial=model.plain(focal_px, rows / 2, columns / 2, pitch),
        typical_sigma=np.array(model.default_typical_sigma),
        free=tuple(name for name in names if name in free),
        magnitude_limit=draw(st.none() | st.floats(3.0, 9.0, **_FLOAT_OPTIONS)),
        readout=draw(st.none() | st.just(Readout(GLOBAL)) | readouts(max(rows, columns))),
        declared=Declared(
            **{name: draw(st.none() | st.sampled_from(list(one.words))) for name, one in DECLARATIONS.items()}
        ),
    )


def readouts(lines):
    return st.builds(
        Readout,
        st.just(ROLLING),
        st.floats(LINE_TIME_S[0], min(LINE_TIME_S[1], 9.9 / lines)).flatmap(lambda s: st.sampled_from([s, -s])),
        st.sampled_from(AXES),
        st.booleans(),
    )


@st.composite
def telemetry_tables(draw):
    sizes = draw(st.lists(st.lists(st.integers(1, 5), min_size=1, max_size=2), min_size=1, max_size=4))
    frame = np.concatenate([np.full(sum(exposures), number) for number, exposures in enumerate(sizes)])
    exposure = np.concatenate([np.repeat(np.arange(len(exposures)), exposures) for exposures in sizes])
    n = len(frame)
    start = draw(st.integers(-5, 1000))
    places = draw(npst.arrays(float, n, elements=st.floats(-10.0, 5000.0, **_FLOAT_OPTIONS), unique=True))
    return Telemetry(
        frame=frame.astype(np.int64) + start,
        exposure=exposure.astype(np.int64),
        row_px=places,
        col_px=draw(npst.arrays(float, n, elements=st.floats(-10.0, 5000.0, **_FLOAT_OPTIONS))),
        time_utc=draw(st.none() | _times(n)),
        magnitude=draw(st.none() | _cells(n, -1.5, 15.0)),
        sigma_px=draw(st.none() | _cells(n, 1e-3, 5.0)),
        star_id=draw(st.none() | st.permutations(range(1, n + 1)).map(lambda ids: np.array(ids, dtype=np.int64))),
        temperature_c=draw(st.none() | _cells(n, -80.0, 80.0)),
        psf_sigma_px=draw(st.none() | _cells(n, 0.3, 12.0)),
        unknown=draw(_unknown_columns(n)),
        **draw(_directions(n)),
        **draw(_quaternions(n)),
        **draw(_velocities(n)),
    )


def _cells(n, low, high):
    return npst.arrays(float, n, elements=st.floats(low, high, **_FLOAT_OPTIONS) | st.just(np.nan))


def _times(n):
    low, high = (int(np.datetime64(day, "us").astype(np.int64)) for day in ("1990-01-01", "2099-12-31"))
    stamps = st.integers(low, high).map(lambda stamp: np.datetime64(stamp, "us")) | st.just(np.datetime64("NaT", "us"))
    return st.lists(stamps, min_size=n, max_size=n).map(lambda values: np.array(values, dtype="datetime64[us]"))


@st.composite
def _directions(draw, n):
    if draw(st.booleans()):
        return {}
    ra_rad = draw(_cells(n, 0.0, 6.28))
    dec_rad = draw(npst.arrays(float, n, elements=st.floats(-1.57, 1.57, **_FLOAT_OPTIONS)))
    return {"ra_rad": ra_rad, "dec_rad": np.where(np.isnan(ra_rad), np.nan, dec_rad)}


@st.composite
def _quaternions(draw, n):
    if draw(st.booleans()):
        return {}
    quaternion = draw(npst.arrays(float, (n, 4), elements=st.floats(0.1, 1.0, **_FLOAT_OPTIONS)))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    quaternion[draw(npst.arrays(bool, n))] = np.nan
    return {"quaternion": quaternion}


@st.composite
def _velocities(draw, n):
    if draw(st.booleans()):
        return {}
    velocity_m_s = draw(npst.arrays(float, (n, 3), elements=st.floats(-7.6e3, 7.6e3, **_FLOAT_OPTIONS)))
    velocity_m_s[draw(npst.arrays(bool, n))] = np.nan
    return {"velocity_m_s": velocity_m_s}


@st.composite
def _unknown_columns(draw, n):
    letters = st.characters(codec="utf-8", exclude_categories=["Cc", "Cs", "Zl", "Zp"])
    names = st.text("abc_xyz", min_size=1, max_size=6).filter(
        lambda name: name not in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)
    )
    cells = st.lists(st.text(letters, max_size=6), min_size=n, max_size=n).map(lambda texts: pa.chunked_array([texts]))
    return draw(st.dictionaries(names, cells, max_size=2))
