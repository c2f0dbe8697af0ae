"""Images come in as telemetry does: packed with what was extracted of them, shown under their frame, refused by name."""

import dataclasses
import hashlib
import io
import itertools
import re
import zipfile

import numpy as np
import pytest
from PIL import Image

from benchmarks.images import OPTICS
from boresight.console.telemetry.service import ARCHIVE
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import CorruptFileError, NotFoundError, RefusedInputError
from boresight.images.archive import TELEMETRY, draw_image, pack, unpack
from boresight.images.detection import DetectionOptions
from boresight.images.extraction import extract
from boresight.images.limits import ImageLimits, ImageSource
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.simulation.images import simulate_images
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import parse_sensor, sensor_document
from boresight.telemetry.working_table import FrameImage, WorkingTable, find_image
from boresight.telemetry.writing import write_csv
from tests.effort import few_of
from tests.images.conftest import clean_images, folder, hard_images, night, small_night  # noqa: F401 - fixtures
from tests.images.files import write_fits

NUMBERS = itertools.count(1)
URL = "/api/v1/telemetry-sets"


@pytest.fixture
def content(folder):  # noqa: F811 - a fixture
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.fits"))[:2]}


def register(house, night):  # noqa: F811 - a fixture
    made = house.person("ada").post(
        "/api/v1/sensors", json=sensor_document(night.sensor) | {"name": f"night camera {next(NUMBERS)}"}
    )
    assert made.status_code == 201, made.text
    return made.json()


def send(house, sensor, files):
    return house.person("ada").post(
        URL, data={"sensor_id": str(sensor["id"])}, files=[("file", one) for one in files.items()]
    )


def zipped(content):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, body in content.items():
            archive.writestr(f"night/{name}", body)
        archive.writestr("night/notes.txt", "clear")
    return stream.getvalue()


def test_images_become_one_set_and_each_frame_shows_its_own(house, night, content):  # noqa: F811 - a fixture
    sensor = register(house, night)
    answer = send(house, sensor, content)
    assert answer.status_code == 201, answer.text
    row = answer.json()
    assert (row["frames"], row["stars"] > 40) == (2, True)
    assert any(finding["code"] == "IMAGES" for finding in row["quality"]["findings"])
    again = send(house, sensor, {"night.zip": zipped(content)})  # the same images, packed by somebody else
    assert again.json()["id"] == row["id"]
    file = house.person("ada").get(f"{URL}/{row['id']}/file")
    with zipfile.ZipFile(io.BytesIO(file.content)) as archive:
        assert sorted(archive.namelist()) == [*content, TELEMETRY]
        assert archive.read(next(iter(content))) == next(iter(content.values()))
    picture = house.person("ada").get(f"/telemetry/{row['id']}/images/0.png")
    with Image.open(io.BytesIO(picture.content)) as shown:
        assert (shown.height, shown.width) == (night.sensor.rows, night.sensor.columns)
    assert house.person("ada").get(f"/telemetry/{row['id']}/images/7.png").status_code == 404


def test_an_image_that_cannot_be_used_is_refused_by_name_and_leaves_nothing(house, night, content):  # noqa: F811 - a fixture
    sensor = register(house, night)
    answer = send(house, sensor, {**content, "cut.fits": b"SIMPLE  = and then nothing"})
    assert answer.status_code == 422
    assert "cut.fits" in answer.json()["detail"]
    assert house.person("ada").get(URL, params={"sensor_id": sensor["id"]}).json()["items"] == []


def test_a_set_of_a_file_has_no_images_and_says_so_in_one_sentence(house):
    row = house.upload(house.person("ada"), house.new_sensor()["id"]).json()
    refused = house.person("victor").get(f"/telemetry/{row['id']}/images/0.png")
    assert refused.status_code == 404
    assert len(re.findall(r"Telemetry set \d+ was not extracted from images[^<.]*\.", refused.text)) == 1
    absent = house.person("victor").get("/telemetry/99999/images/0.png")
    assert absent.status_code == 404


def launch(house, sensor, row):
    """A run on a set, which waits for workers that there are not: its frames show under the sensor's own parameters."""
    order = {"sensor_id": sensor["id"], "telemetry_set_id": row["id"], "settings": {"method": "batch"}}
    made = house.person("ada").post("/api/v1/runs", json=order)
    assert made.status_code == 202, made.text
    return made.json()["id"]


def symbols(page):
    """The stars that a frame's drawing shows: state, Hipparcos number (0 = none), column and row of each."""
    found = []
    for state, number, mark in re.findall(
        r'<g class="star ([\w-]+)" data-star="\d+"><title>(?:HIP (\d+)|no star).*?<(?:circle|rect|path) class="mark" ([^>]+?)/>',
        page,
        re.DOTALL,
    ):
        place = [float(text) for text in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", mark)]
        found.append((state, int(number or 0), *place[:2]))
    return found


@pytest.mark.full
@pytest.mark.parametrize("parity", few_of([1, -1], 1))
def test_a_frame_s_stars_and_matches_lie_where_its_picture_shows_them(house, parity, catalogue, tmp_path):
    dusk = of_parity(small_night(2), parity)
    images = list(simulate_images(dusk, OPTICS, np.random.default_rng(3), catalogue))
    files = {f"{one.frame}.fits": write_fits(tmp_path / f"{one.frame}.fits", one).read_bytes() for one in images}
    sensor = register(house, dusk)
    row = send(house, sensor, files).json()
    run_id = launch(house, sensor, row)
    viewer, frame = house.person("victor"), images[1]
    page = viewer.get(f"/runs/{run_id}", params={"part": "evidence", "frame": 1, "show": "old"})
    shown = viewer.get(f"/api/v1/runs/{run_id}/frames/1").json()
    stars = shown["exposures"][0]["stars"]
    drawn = symbols(page.text)
    assert len(drawn) == len(stars) > 20
    used = [one for one in drawn if one[0] == "used"]
    assert len(used) == sum(one["fate"] == "used" for one in stars) > 10
    assert len(re.findall('<line class="old"', page.text)) >= len(used)
    address = f"/telemetry/{row['id']}/images/1.png"
    assert (
        page.text.count(f'<image class="frame-image" href="{address}" x="-0.5" y="-0.5" width="640" height="480"') == 1
    )
    with Image.open(io.BytesIO(viewer.get(address).content)) as picture:
        grey = np.asarray(picture)
    where = {int(hip): place for hip, *place in zip(frame.star_id, frame.col_px, frame.row_px, strict=True)}
    for _, hip, x, y in used:
        assert np.hypot(x - where[hip][0], y - where[hip][1]) < 0.5
        around = grey[max(round(y) - 1, 0) : round(y) + 2, max(round(x) - 1, 0) : round(x) + 2]
        assert around.max() > np.quantile(grey, 0.98)
    assert shown["image"] == {"name": "1.fits", "sha256": hashlib.sha256(files["1.fits"]).hexdigest()}
    assert shown["image"]["sha256"] in page.text
    assert ">1.fits<" in page.text


def of_parity(scenario, parity):
    document = sensor_document(scenario.sensor) | {"parity": parity}
    return dataclasses.replace(scenario, sensor=parse_sensor(document))


def test_a_viewer_may_look_at_a_frame_s_picture_and_who_is_not_logged_in_may_not(house, night, content):  # noqa: F811 - a fixture
    row = send(house, register(house, night), content).json()
    address = f"/telemetry/{row['id']}/images/0.png"
    seen = house.person("victor").get(address)
    assert (seen.status_code, seen.headers["content-type"]) == (200, "image/png")
    tag = {"If-None-Match": seen.headers["etag"]}
    assert house.person("victor").get(address, headers=tag).status_code == 304
    for headers in ({}, tag):
        refused = house.anybody().get(address, headers=headers)
        assert refused.status_code in {303, 401}
        assert not refused.content.startswith(b"\x89PNG")


@pytest.mark.full
def test_the_hash_of_each_image_stays_with_its_frame_in_store_and_export(house, night, content, tmp_path):  # noqa: F811 - a fixture
    row = send(house, register(house, night), content).json()
    hashes = [hashlib.sha256(body).hexdigest() for body in content.values()]
    with open_reading(house.app.state.engine) as session:
        table = session.get_one(TelemetrySet, row["id"]).table_sha256
    stored = WorkingTable(table_path(house.app.state.blobs, table)).read()
    assert [find_image(stored, int(np.searchsorted(stored.frame, k))).sha256 for k in (0, 1)] == hashes
    (tmp_path / "set.zip").write_bytes(house.person("victor").get(f"{URL}/{row['id']}/file").content)
    with zipfile.ZipFile(tmp_path / "set.zip") as archive:
        archive.extract(TELEMETRY, tmp_path)
    exported = read_telemetry(tmp_path / TELEMETRY)
    assert [
        exported.unknown["image_sha256"].to_pylist()[k] for k in np.unique(exported.frame, return_index=True)[1]
    ] == hashes
    write_csv(stored, tmp_path / "again.csv")
    assert set(read_telemetry(tmp_path / "again.csv").unknown["image_sha256"].to_pylist()) == set(hashes)


@pytest.mark.full
def test_an_image_that_is_not_the_one_its_frame_was_extracted_from_is_not_drawn(house, night, content):  # noqa: F811 - a fixture
    row = send(house, register(house, night), content).json()
    first, second = content
    swapped = io.BytesIO()
    with zipfile.ZipFile(swapped, "w") as archive:
        archive.writestr(first, content[second])
        archive.writestr(second, content[second])
    exchange_file(house, row["id"], swapped.getvalue())
    refused = house.person("victor").get(f"/telemetry/{row['id']}/images/0.png")
    assert refused.status_code == 409
    assert not refused.content.startswith(b"\x89PNG")
    assert first in refused.text
    assert house.person("victor").get(f"/telemetry/{row['id']}/images/1.png").status_code == 200


def test_a_set_of_before_that_does_not_keep_the_hash_still_shows_its_picture_and_checks_it(
    night,  # noqa: F811 - a fixture
    content,
    tmp_path,
):
    sources = []
    for name, body in content.items():
        (tmp_path / name).write_bytes(body)
        sources.append(ImageSource(tmp_path / name, name))
    pack(sources, extract(sources, night.sensor, DetectionOptions()), tmp_path / "night.zip")
    assert draw_image(tmp_path / "night.zip", night.sensor, 1, ImageLimits(), tmp_path).startswith(b"\x89PNG")
    other = FrameImage(next(iter(content)), "0" * 64)
    with pytest.raises(CorruptFileError, match=other.name):
        draw_image(tmp_path / "night.zip", night.sensor, 0, ImageLimits(), tmp_path, other)
    with pytest.raises(NotFoundError):
        draw_image(tmp_path / "night.zip", night.sensor, 7, ImageLimits(), tmp_path)


def exchange_file(house, set_id, body):
    """Put another archive in the place of a set's, as a mistake at restoring might."""
    with open_writing(house.app.state.engine) as session:
        sha256 = house.app.state.blobs.put(body)
        register_blob(session, house.app.state.blobs, sha256, ARCHIVE)
        session.get_one(TelemetrySet, set_id).original_sha256 = sha256
        audit.append(session, SYSTEM, "brought in", f"telemetry-sets/{set_id}")


def damaged(method):
    """An archive whose packed bytes are none of its method."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        archive.writestr("a.png", np.random.default_rng(1).integers(0, 9, 3000).astype(np.uint8).tobytes())
    body = bytearray(packed.getvalue())
    body[60:200] = b"\xff" * 140
    return bytes(body)


def test_archives_are_held_to_what_images_may_hold(tmp_path, content):
    path = tmp_path / "n.zip"
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.fits", bytes(30_000_000))
    for body, limits in (
        (bomb.getvalue(), ImageLimits()),
        (zipped(content), ImageLimits(images=1)),
        (zipped(content), ImageLimits(file_bytes=1000)),
        (zipped({}), ImageLimits()),
        (zipped(content)[:-100], ImageLimits()),
        (damaged(zipfile.ZIP_DEFLATED), ImageLimits()),
        (damaged(zipfile.ZIP_LZMA), ImageLimits()),
        (zipped({f"{number}.txt": b"" for number in range(20_001)}), ImageLimits()),
    ):
        path.write_bytes(body)
        with pytest.raises(RefusedInputError, match=r"n\.zip"):
            unpack(path, "n.zip", tmp_path, limits)
