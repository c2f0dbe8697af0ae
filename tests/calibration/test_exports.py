"""Files for other programs: each of those reads its file and sees stars where the camera does, whichever way it counts pixels."""

import ast
import importlib
import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import yaml

from boresight.calibration.exports import EXPORT_FORMATS, ExposureAttitude, Source, export
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_matrix
from boresight.sky.apparent import aberrated
from tests.uplink.packages import make_sensor

#: A header without an image is what astropy warns of.
pytestmark = pytest.mark.filterwarnings("ignore:The WCS transformation has more axes")
MODELS = sorted(CAMERA_MODELS)
PARITIES = (-1, 1)
#: A lens of either direction of running, mirrored and not; every pair is for the whole suite.
PAIRS = [
    pytest.param(
        model,
        parity,
        marks=() if (model, parity) in {("inverted_wang", 1), ("brown_conrady", -1)} else pytest.mark.full,
    )
    for model in MODELS
    for parity in PARITIES
]
LENS_FORMATS = [name for name, form in EXPORT_FORMATS.items() if form.lenses]


def camera_of(model, parity):
    """Return a sensor of 1024 x 1024 whose lens has a part of every term, and its parameters."""
    sensor = make_sensor(model, parity)
    camera = CAMERA_MODELS[model]
    spread = 0.05 * np.array(camera.default_typical_sigma)
    spread *= np.where([unit.startswith("m⁻") for unit in camera.units], 0.1, 1.0)  # 60 mm of focal length, no fisheye
    x = camera.plain(4000.0, 517.4, 505.3, sensor.pixel_pitch_m) + spread
    return sensor, x


def written(name, model, parity, allowed_px=0.05, **others):
    """Return a file as text or bytes, its description, and what it is of."""
    sensor, x = camera_of(model, parity)
    source = Source("PS-FM1-1", "ab" * 32, sensor)
    content, told = export(EXPORT_FORMATS[name], source, x, allowed_px=allowed_px, **others)
    return content, told, sensor, x


def installed(name):
    """Return a module that the Python registry does not have for us, where somebody has put it all the same; else None."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def places(sensor):
    """Rows and columns over the detector, none of the fit's grid."""
    random = np.random.default_rng(7)
    return random.uniform(-0.5, sensor.rows - 0.5, 300), random.uniform(-0.5, sensor.columns - 0.5, 300)


def in_their_frame(told, sensor, x, row, column):
    """Directions (n, 3) of places in the frame of the file, by what its description says of that; and the columns they are at."""
    s = CAMERA_MODELS[sensor.camera_model].directions(x, row, column, sensor.pixel_pitch_m)
    triad = s * np.array([1.0, sensor.parity, 1.0])
    frame = np.array(told["camera_from_triad"])
    assert np.linalg.det(frame) == pytest.approx(1.0)
    return triad @ frame.T, sensor.columns - 1 - column if told["mirrored"] else column


def opencv_pixels(cv2, matrix, coefficients, s, *, fisheye=False):
    """Where OpenCV's own functions put directions: (columns, rows)."""
    points, still = np.ascontiguousarray(s)[:, None, :], np.zeros(3)
    if fisheye:
        seen, _ = cv2.fisheye.projectPoints(points, still, still, matrix, coefficients)
    else:
        seen, _ = cv2.projectPoints(points, still, still, matrix, coefficients)
    return seen[:, 0, :].T


def assert_same_places(theirs, told, row, column):
    """Hold their pixels against ours: as near as the file says that it is."""
    away = np.hypot(theirs[0] - column, theirs[1] - row)
    assert away.max() <= told["misfit_px"]["max"] * 1.05 + 1e-6


@pytest.mark.parametrize(("model", "parity"), PAIRS)
def test_opencv_reads_its_file_and_projects_stars_to_the_same_pixels(model, parity, tmp_path):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    content, told, sensor, x = written("opencv", model, parity)
    (tmp_path / "camera.yaml").write_bytes(content)
    storage = cv2.FileStorage(str(tmp_path / "camera.yaml"), cv2.FILE_STORAGE_READ)
    matrix, coefficients = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    assert int(storage.getNode("image_width").real()) == sensor.columns
    row, column = places(sensor)
    s, column = in_their_frame(told, sensor, x, row, column)
    theirs = opencv_pixels(cv2, matrix, coefficients.ravel(), s, fisheye=told["lens"] == "equidistant")
    assert_same_places(theirs, told, row, column)
    own = {"brown_conrady": "plumb_bob", "pinhole_radial": "plumb_bob", "kannala_brandt": "equidistant"}
    if model in own:
        assert told["lens"] == own[model]
        assert told["misfit_px"]["max"] < 1e-9


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize("model", ["brown_conrady", "kannala_brandt", "pinhole_radial"])
def test_a_ros_file_is_yaml_whose_model_opencv_projects_with(model, parity):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    content, told, sensor, x = written("ros", model, parity)
    document = yaml.safe_load(content)
    assert document["distortion_model"] == ("equidistant" if model == "kannala_brandt" else "plumb_bob")
    matrix = np.array(document["camera_matrix"]["data"], float).reshape(3, 3)
    coefficients = np.array(document["distortion_coefficients"]["data"], float)
    row, column = places(sensor)
    s, column = in_their_frame(told, sensor, x, row, column)
    theirs = opencv_pixels(cv2, matrix, coefficients, s, fisheye=model == "kannala_brandt")
    assert_same_places(theirs, told, row, column)


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize("model", ["brown_conrady", "kannala_brandt", "pinhole_radial"])
def test_colmap_reads_its_file_and_projects_stars_half_a_pixel_on(model, parity, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="COLMAP is not installed")
    content, told, sensor, x = written("colmap", model, parity)
    (tmp_path / "cameras.txt").write_bytes(content)
    for name in ("images.txt", "points3D.txt"):
        (tmp_path / name).write_text("#\n")
    reconstruction = pycolmap.Reconstruction()
    reconstruction.read_text(str(tmp_path))
    camera = reconstruction.cameras[1]
    assert (camera.width, camera.height) == (sensor.columns, sensor.rows)
    row, column = places(sensor)
    s, column = in_their_frame(told, sensor, x, row, column)
    theirs = np.array([camera.img_from_cam(one) for one in s]).T - 0.5
    assert_same_places(theirs, told, row, column)


@pytest.mark.parametrize(("model", "parity"), PAIRS)
def test_mrcal_s_file_is_a_literal_with_its_model_and_reads_as_opencv_s(model, parity, tmp_path):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    content, told, sensor, x = written("mrcal", model, parity, allowed_px=0.5)
    document = ast.literal_eval(content.decode())
    values = document["intrinsics"]
    assert document["lensmodel"] == f"LENSMODEL_OPENCV{len(values) - 4}"
    assert document["imagersize"] == [sensor.columns, sensor.rows]
    matrix = np.array([[values[0], 0, values[2]], [0, values[1], values[3]], [0, 0, 1.0]])
    row, column = places(sensor)
    s, column = in_their_frame(told, sensor, x, row, column)
    assert_same_places(opencv_pixels(cv2, matrix, np.array(values[4:]), s), told, row, column)
    mrcal = installed("mrcal")
    if mrcal is None:
        return
    (tmp_path / "a.cameramodel").write_bytes(content)
    read = mrcal.cameramodel(str(tmp_path / "a.cameramodel"))
    assert_same_places(mrcal.project(s, *read.intrinsics()).T, told, row, column)


@pytest.mark.parametrize("name", ["tetra3", "cedar"])
@pytest.mark.parametrize("parity", PARITIES)
def test_tetra3_s_own_equations_turn_centroids_into_the_camera_s_directions(name, parity):
    tetra3 = pytest.importorskip("tetra3.tetra3", reason="cedar-solve is not installed")
    content, told, sensor, x = written(name, "pinhole_radial", parity, allowed_px=1.0)
    document = json.loads(content)
    row, column = places(sensor)
    s, column = in_their_frame(told, sensor, x, row, column)
    centroids = np.stack([row, column], axis=-1) + document["centroid_offset_px"]
    straight = tetra3._undistort_centroids(centroids, document["size"], document["distortion"])
    vectors = tetra3._compute_vectors(straight, document["size"], math.radians(document["fov_estimate"]))
    theirs = np.stack([-vectors[:, 1], -vectors[:, 2], vectors[:, 0]], axis=-1)  # theirs: boresight, left, up
    away_px = np.linalg.norm(theirs - s, axis=-1) * told["parameters"]["f"]
    assert away_px.max() <= told["misfit_px"]["max"] * 1.1 + 1e-3  # they compute in single precision


def _giant_pixels(kind, values, s):
    """GIANT's equations, as its documentation writes them."""
    f = values.get("focal_length", 1.0)
    x, y = f * s[:, 0] / s[:, 2], f * s[:, 1] / s[:, 2]
    r = np.hypot(x, y)
    if kind == "Brown":
        radial = values["k1"] * r**2 + values["k2"] * r**4 + values["k3"] * r**6
        p1, p2 = values["p1"], values["p2"]
        at_x = x + radial * x + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
        at_y = y + radial * y + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    else:
        scale = values["radial2"] * r**2 + values["radial4"] * r**4
        scale = scale + values["tangential_y"] * y + values["tangential_x"] * x
        pinwheel = values["pinwheel1"] * r + values["pinwheel2"] * r**3
        at_x, at_y = x + scale * x - pinwheel * y, y + scale * y + pinwheel * x
    return values["kx"] * at_x + values["px"], values["ky"] * at_y + values["py"]


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize(("name", "kind"), [("giant-brown", "Brown"), ("giant-owen", "Owen")])
@pytest.mark.parametrize("model", ["brown_conrady", "inverted_wang"])
def test_giant_s_xml_and_json_say_the_same_camera_in_its_equations(model, name, kind, parity, tmp_path):
    texts = {suffix: written(name, model, parity, allowed_px=0.5, suffix=suffix) for suffix in (".xml", ".json")}
    content, told, sensor, x = texts[".xml"]
    arguments = json.loads(texts[".json"][0])
    node = ET.fromstring(content).find(".//camera")  # noqa: S314 - our own
    assert node.get("type") == arguments["class"] == f"{kind}Model"
    literals = {one.tag: one.text for one in node}
    for key, value in arguments["arguments"].items():
        assert ast.literal_eval(literals[key]) == value
    row, column = places(sensor)
    s, column = in_their_frame(told, sensor, x, row, column)
    assert_same_places(_giant_pixels(kind, arguments["arguments"], s), told, row, column)
    giant = installed("giant.camera_models")
    if giant is None:
        return
    (tmp_path / "camera.xml").write_bytes(content)
    assert_same_places(giant.load(tmp_path / "camera.xml", "camera").project_onto_image(s.T), told, row, column)


def exposure(quaternion=(0.1, -0.4, 0.3, 0.86), velocity=(1e-4, -3e-5, 2e-5), frame=3):
    q = np.array(quaternion)
    return ExposureAttitude(
        frame=frame,
        exposure=1,
        stars=9,
        quaternion=q / np.linalg.norm(q),
        covariance=np.diag([4e-12, 9e-12, 1e-9]),
        time_utc="2026-03-01T12:00:00.000000",
        velocity_c=None if velocity is None else np.array(velocity),
    )


POLE = (0.0, 0.0, 0.6, 0.8)  # the boresight on the celestial pole


@pytest.mark.parametrize("name", ["fits-sip", "fits-tpv"])
@pytest.mark.parametrize(("model", "parity"), PAIRS)
def test_astropy_s_wcs_turns_pixels_into_the_places_of_stars_and_back(model, name, parity):
    fits, wcs = pytest.importorskip("astropy.io.fits"), pytest.importorskip("astropy.wcs")
    exposures = [exposure(), exposure(POLE, velocity=None, frame=4)]
    content, told, sensor, x = written(name, model, parity, exposures=exposures)
    with fits.HDUList.fromstring(content) as parts:
        headers = [part.header for part in parts[1:]]
    assert [header["EXTNAME"] for header in headers] == ["F3E1", "F4E1"]
    row, column = places(sensor)
    s = CAMERA_MODELS[model].directions(x, row, column, sensor.pixel_pitch_m) * np.array([1.0, parity, 1.0])
    for header, one in zip(headers, exposures, strict=True):
        seen = wcs.WCS(header)
        ra, dec = np.radians(seen.all_pix2world(column + 1.0, row + 1.0, 1))
        at_rest = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
        apparent = at_rest if one.velocity_c is None else aberrated(at_rest, one.velocity_c)
        away_px = np.linalg.norm(apparent @ to_matrix(one.quaternion).T - s, axis=-1) * 4000.0
        assert away_px.max() <= told["misfit_px"]["max"] * 1.1 + 1e-6
        back = seen.all_world2pix(np.degrees(ra), np.degrees(dec), 1, tolerance=1e-7, maxiter=100)
        np.testing.assert_allclose(back, (column + 1.0, row + 1.0), rtol=0, atol=1e-5)
        assert header["CRDER1"] == pytest.approx(math.degrees(3e-6))
        assert header["MISFIT"] <= told["allowed_px"]
    assert "apparent" in str(headers[1]["COMMENT"])


def test_the_way_back_of_sip_is_as_near_as_the_way_there():
    fits, wcs = pytest.importorskip("astropy.io.fits"), pytest.importorskip("astropy.wcs")
    content, _, sensor, _ = written("fits-sip", "inverted_wang", -1, exposures=[exposure()])
    with fits.HDUList.fromstring(content) as parts:
        seen = wcs.WCS(parts[1].header)
    row, column = places(sensor)
    focal = np.stack(seen.sip_pix2foc(column + 1.0, row + 1.0, 1), axis=-1)
    back = seen.sip_foc2pix(focal, 1)
    np.testing.assert_allclose(back, np.stack([column + 1.0, row + 1.0], axis=-1), rtol=0, atol=0.01)


def test_what_a_calibration_leaves_over_is_followed_where_it_is_asked_for():
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    sensor, x = camera_of("brown_conrady", -1)

    def surface(row, column):
        return np.stack([0.3 * np.sin(row / 400.0), 0.2 * np.cos(column / 500.0)], axis=-1)

    source = Source("PS-FM1-1", None, sensor)
    content, told = export(EXPORT_FORMATS["opencv"], source, x, residual=surface, allowed_px=0.1)
    plain, _ = export(EXPORT_FORMATS["opencv"], source, x)
    assert content != plain
    row, column = places(sensor)
    off = surface(row, column)  # a star measured here has the direction of the place without it
    s, _ = in_their_frame(told, sensor, x, row - off[:, 0], column - off[:, 1])
    values = told["parameters"]
    matrix = np.array([[values["f_x"], 0, values["c_x"]], [0, values["f_y"], values["c_y"]], [0, 0, 1.0]])
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
    coefficients = np.array([values.get(name, 0.0) for name in names])
    assert_same_places(opencv_pixels(cv2, matrix, coefficients, s), told, row, column)


def test_sigmas_are_those_of_the_camera_where_the_lens_is_its_own():
    sensor, x = camera_of("brown_conrady", -1)
    P = np.diag((0.01 * np.array(CAMERA_MODELS["brown_conrady"].default_typical_sigma)) ** 2)
    _, told = export(EXPORT_FORMATS["opencv"], Source("PS-FM1-1", None, sensor), x, P=P)
    state = dict(zip(CAMERA_MODELS["brown_conrady"].parameter_names, np.sqrt(np.diag(P)), strict=True))
    assert told["sigma"]["f_x"] == pytest.approx(state["f_m"] / sensor.pixel_pitch_m, rel=1e-4)
    assert told["sigma"]["c_y"] == pytest.approx(state["v0_px"], rel=1e-4)
    for name in ("k1", "k2", "k3", "p1", "p2"):
        assert told["sigma"][name] == pytest.approx(state[name], rel=1e-4)


@pytest.mark.parametrize("name", LENS_FORMATS)
def test_a_camera_that_a_program_cannot_follow_is_refused_by_default_and_written_where_more_is_allowed(name):
    sensor = make_sensor("inverted_wang", -1)  # 50 degrees of field
    source = Source("PS-FM1-1", None, sensor)
    with pytest.raises(RefusedInputError):
        export(EXPORT_FORMATS[name], source, sensor.initial, allowed_px=1e-9)
    _, told = export(EXPORT_FORMATS[name], source, sensor.initial, allowed_px=1e3)
    assert 1e-9 < told["misfit_px"]["max"] < 1e3
    assert told["allowed_px"] == 1e3


def test_headers_without_telemetry_are_refused():
    sensor, x = camera_of("inverted_wang", 1)
    with pytest.raises(RefusedInputError):
        export(EXPORT_FORMATS["fits-sip"], Source("PS-FM1-1", None, sensor), x)


@pytest.mark.parametrize("name", sorted(EXPORT_FORMATS))
def test_every_file_says_what_it_was_made_of(name):
    sensor, x = camera_of("brown_conrady", -1)
    source = Source("PS-FM1-1\n--> rogue: 1", "cd" * 32, sensor)
    content, told = export(EXPORT_FORMATS[name], source, x, allowed_px=1.0, exposures=[exposure()])
    assert ("cd" * 32).encode() in content
    assert b"\n--> rogue" not in content
    assert told["source"]["sha256"] == "cd" * 32
    assert told["schema"] == "boresight.export/1"
