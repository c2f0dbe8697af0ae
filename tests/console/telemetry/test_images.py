"""Images come in as telemetry does: packed with what was extracted of them, shown under their frame, refused by name."""

import io
import itertools
import zipfile

import pytest
from PIL import Image

from boresight.errors import RefusedInputError
from boresight.images.archive import TELEMETRY, unpack
from boresight.images.limits import ImageLimits
from boresight.telemetry.sensors import sensor_document
from tests.images.conftest import clean_images, folder, hard_images, night  # noqa: F401 - fixtures

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


def test_a_set_of_a_file_has_no_images(house):
    row = house.upload(house.person("ada"), house.new_sensor()["id"]).json()
    assert house.person("ada").get(f"/telemetry/{row['id']}/images/0.png").status_code == 404


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
    ):
        path.write_bytes(body)
        with pytest.raises(RefusedInputError, match=r"n\.zip"):
            unpack(path, "n.zip", tmp_path, limits)
