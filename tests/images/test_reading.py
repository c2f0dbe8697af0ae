"""Every format gives the same numbers; times come from where they are believed; what cannot be read is named and never expanded."""

import gzip
import io
import json
import struct
import zlib

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image as Pillow
from PIL.TiffImagePlugin import IFDRational

from boresight.errors import RefusedInputError
from boresight.images.extraction import read_times
from boresight.images.limits import ImageLimits
from boresight.images.reading import parse_raw, read_image, time_in_name
from boresight.telemetry.sensors import parse_sensor, sensor_document
from tests.images.files import write_fits
from tests.refusals import has_code


@pytest.fixture
def image(hard_images):
    return hard_images[0]


def test_every_format_holds_the_same_numbers(image, night, tmp_path):
    write_fits(tmp_path / "a.fits", image)
    fits.CompImageHDU(image.dn, compression_type="RICE_1").writeto(tmp_path / "a.fz")
    (tmp_path / "a.fits.gz").write_bytes(gzip.compress((tmp_path / "a.fits").read_bytes()))
    for name in ("a.png", "a.tif"):
        Pillow.fromarray(image.dn).save(tmp_path / name)
    (tmp_path / "a.raw").write_bytes(b"head" + image.dn.astype(">u2").tobytes())
    raw = parse_raw({"bits": 16, "byte_order": "big", "header_bytes": 4})
    for path in sorted(tmp_path.iterdir()):
        read = read_image(path, night.sensor, raw)
        assert np.array_equal(read.dn, image.dn), path.name
        assert len(read.sha256) == 64


def test_the_sensor_file_says_how_raw_numbers_are_read(image, night, tmp_path):
    document = sensor_document(night.sensor) | {"image": {"bits": 12, "gain_e_per_dn": 2.0}}
    sensor = parse_sensor(document)
    assert sensor_document(sensor)["image"] == document["image"]
    path = tmp_path / "a.raw"
    path.write_bytes((image.dn % 4096).astype("<u2").tobytes())
    assert np.array_equal(read_image(path, sensor).dn, image.dn % 4096)
    path.write_bytes((image.dn % 4096).astype(">u2").tobytes())
    with pytest.raises(RefusedInputError, match="big"):  # more than twelve bits can hold
        read_image(path, sensor)
    for wrong in ({"bits": 7}, {"bits": 12.5}, {"byte_order": "middle"}, {"depth": 8}, 12, {"gain_e_per_dn": 0}):
        with pytest.raises(RefusedInputError, match="image"):
            parse_sensor(document | {"image": wrong})


def test_times_are_of_mid_exposure(image, night, tmp_path):
    read = read_image(write_fits(tmp_path / "a.fits", image), night.sensor)
    assert read.time_utc == image.time_utc
    path = write_fits(tmp_path / "b.fits", image, TIMESYS="TAI")
    assert image.time_utc - read_image(path, night.sensor).time_utc == np.timedelta64(37_000_000, "us")
    path = write_fits(tmp_path / "c.fits", image, DATE_AVG="2026-01-02T03:04:05.5")
    assert read_image(path, night.sensor).time_utc == np.datetime64("2026-01-02T03:04:05.5")
    listed = {"a.fits": np.datetime64("2020-01-01T00:00:00", "us")}
    assert read_image(tmp_path / "a.fits", night.sensor, times=listed).time_utc == listed["a.fits"]


def test_exif_says_when_a_picture_was_taken(image, night, tmp_path):
    exif = Pillow.Exif()
    block = exif.get_ifd(0x8769)
    block.update({36867: "2026:11:24 23:01:05", 37521: "25", 36881: "+01:00", 33434: IFDRational(1, 2)})
    exif[0x8769] = block
    Pillow.fromarray(image.dn).save(tmp_path / "a.tif", exif=exif)
    assert read_image(tmp_path / "a.tif", night.sensor).time_utc == np.datetime64("2026-11-24T22:01:05.500", "us")


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("night_20261124T220105.25.fits", "2026-11-24T22:01:05.25"),
        ("2026-11-24_22-01-05.png", "2026-11-24T22:01:05"),
        ("img-0042.png", None),
        ("20261324T990105.raw", None),
    ],
)
def test_a_name_may_hold_the_time(name, time):
    assert time_in_name(name) == (None if time is None else np.datetime64(time, "us"))


def png_head(width, height):
    """A PNG that says it is huge, and holds next to nothing."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


def bomb_fits():
    stream = io.BytesIO()
    fits.PrimaryHDU(np.zeros((4, 4), np.int16)).writeto(stream)
    return stream.getvalue().replace(b"NAXIS1  =                    4", b"NAXIS1  =              4000000")


def damaged_fits():
    stream = io.BytesIO()
    fits.PrimaryHDU(np.zeros((480, 640), np.int16)).writeto(stream)
    return stream.getvalue()[:10_000]


def a_table():
    stream = io.BytesIO()
    fits.BinTableHDU.from_columns([fits.Column("X", "E", array=np.zeros(3))]).writeto(stream)
    return stream.getvalue()


def colours_of_16_bits():
    head = struct.pack(">IIBBBBB", 640, 480, 16, 2, 0, 0, 0)
    body = png_head(640, 480)
    return body[:16] + head + struct.pack(">I", zlib.crc32(b"IHDR" + head)) + body[33:]


def written(dn, **header):
    stream = io.BytesIO()
    fits.PrimaryHDU(dn, fits.Header({key.replace("_", "-"): value for key, value in header.items()})).writeto(stream)
    return stream.getvalue()


def overfull_tile():
    """A compressed image whose only tile expands to 60 MB."""
    stream, packed = io.BytesIO(), gzip.compress(bytes(60_000_000))
    tiled = fits.CompImageHDU(np.zeros((64, 64), np.int16), compression_type="GZIP_1", tile_shape=(64, 64))
    fits.HDUList([fits.PrimaryHDU(), tiled]).writeto(stream)
    with fits.open(io.BytesIO(stream.getvalue()), disable_image_compression=True) as file:
        head, begin, after = file[1].header, file[1].fileinfo()["hdrLoc"], file[1].fileinfo()["datLoc"]
        head["PCOUNT"] = len(packed)
        row = struct.pack(">ii", len(packed), 0) + stream.getvalue()[after + 8 : after + head["NAXIS1"]]
        body = row + packed
        return stream.getvalue()[:begin] + head.tostring().encode() + body + bytes(-len(body) % 2880)


def damaged_gzip():
    packed = bytearray(gzip.compress(np.random.default_rng(1).integers(0, 9, 30_000).astype(np.uint8).tobytes()))
    packed[20:400] = b"\xff" * 380
    return bytes(packed)


SMALL, BEGUN = np.zeros((4, 4), np.int16), "2026-11-24T22:01:05"
WRONG = {
    "tile.fits": overfull_tile(),
    "damaged.gz": damaged_gzip(),
    "long.fits": written(SMALL, DATE_OBS=BEGUN, EXPTIME=1e300),
    "long-20261124T220105.fits": written(np.zeros((480, 640), np.int16), EXPTIME=1e300),
    "far.fits": written(SMALL, DATE_OBS="99999999-01-01T00:00:00"),
    "empty.fits": b"",
    "text.fits": b"frame,exposure\n1,2\n",
    "photo.jpg": b"\xff\xd8\xff\xe0rest",
    "bomb.png": png_head(60_000, 60_000),
    "bomb.fits": bomb_fits(),
    "bomb.fits.gz": gzip.compress(bytes(40_000_000)),
    "cut.gz": gzip.compress(bytes(10_000))[:20],
    "damaged.fits": damaged_fits(),
    "table.fits": a_table(),
    "short.raw": bytes(1000),
    "cut.png": png_head(640, 480),
    "colours.png": colours_of_16_bits(),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_read_is_refused_by_its_name(name, night, tmp_path):
    path = tmp_path / name
    path.write_bytes(WRONG[name])
    limits = ImageLimits(pixels=4_000_000)
    with pytest.raises(RefusedInputError, match=name):
        read_image(path, night.sensor, parse_raw({"bits": 16}), limits=limits)


def test_pixels_without_a_number_are_sky_in_a_tiff_as_in_fits(night, tmp_path):
    dn = np.full((480, 640), 7.0, np.float32)
    dn[3, 4], dn[5, 6] = np.nan, np.inf
    Pillow.fromarray(dn).save(tmp_path / "a.tif")
    image = read_image(tmp_path / "a.tif", night.sensor)
    assert np.all(image.dn == 7.0)
    assert len(image.notes) == 1


def test_an_image_of_another_size_is_refused(night, hard_images, tmp_path):
    fits.writeto(tmp_path / "a.fits", hard_images[0].dn.T.copy())
    with pytest.raises(RefusedInputError, check=has_code("rows-and-columns-exchanged")):
        read_image(tmp_path / "a.fits", night.sensor)
    path = write_fits(tmp_path / "b.fits", hard_images[0])
    with pytest.raises(RefusedInputError, match=r"b\.fits"):
        read_image(path, night.sensor, limits=ImageLimits(file_bytes=1000))


def test_a_list_of_times_is_read_or_refused_by_row(tmp_path):
    path = tmp_path / "times.csv"
    path.write_text("image,time_utc\na.png,2026-11-24T22:01:05.25Z\n")
    assert read_times(path) == {"a.png": np.datetime64("2026-11-24T22:01:05.25", "us")}
    path.write_text("image,time_utc\na.png,yesterday\n")
    with pytest.raises(RefusedInputError, match=r"row 2\b.*time_utc"):
        read_times(path)
    path.write_text("name,when\n")
    with pytest.raises(RefusedInputError, match="columns"):
        read_times(path)
    assert json.dumps(str(path))
