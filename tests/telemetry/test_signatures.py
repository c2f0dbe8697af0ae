"""A file that is neither telemetry nor JSON is called what it is, whatever its name, by its first bytes."""

import bz2
import gzip
import io
import lzma
import sqlite3
import tarfile
import zipfile

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather

from boresight.errors import RefusedInputError
from boresight.telemetry.read.formats import read_text
from boresight.telemetry.sensors import read_sensor
from tests.telemetry.files import GOOD, refused

IMAGES = {
    "FITS": b"SIMPLE  =                    T / conforms to FITS".ljust(80)
    + b"BITPIX  =                   16".ljust(80),
    "TIFF": b"II*\0\x08\0\0\0\x0e\0",
    "PNG": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
    "JPEG": b"\xff\xd8\xff\xe0\0\x10JFIF\0",
}


def archive(name, content=b"x"):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        made.writestr(name, content)
    return file.getvalue()


def arrays(save, *values, **named):
    file = io.BytesIO()
    save(file, *values, **named)
    return file.getvalue()


def tape():
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as made:
        made.addfile(tarfile.TarInfo("pass.csv"))
    return file.getvalue()


def arrow():
    file = io.BytesIO()
    feather.write_feather(pa.table({"frame": [0]}), file)
    return file.getvalue()


def database():
    with sqlite3.connect(":memory:") as made:
        made.execute("CREATE TABLE stars (frame INTEGER)")
        return made.serialize()


OTHERS = {
    "ZIP archive": archive("pass.csv"),
    "Excel workbook": archive("xl/workbook.xml"),
    "NumPy arrays": arrays(np.savez, row_px=np.zeros(3)),
    "NumPy array": arrays(np.save, np.zeros(3)),
    "gzip": gzip.compress(GOOD.encode()),
    "bzip2": bz2.compress(GOOD.encode()),
    "xz": lzma.compress(GOOD.encode()),
    "tar": tape(),
    "PDF": b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n",
    "HDF5": b"\x89HDF\r\n\x1a\n\0\0\0\0",
    "Arrow": arrow(),
    "Feather": b"FEA1\0\0\0\0",
    "SQLite": database(),
    "ELF": b"\x7fELF\x02\x01\x01\0",
}


@pytest.mark.parametrize("name", ["pass.csv", "pass.jsonl", "pass.parquet", "pass", "pass.fits"])
@pytest.mark.parametrize("kind", IMAGES)
def test_an_image_is_told_that_centroids_are_read_and_not_to_be_saved_as_utf8(read, kind, name):
    sentence = str(refused(read, IMAGES[kind], name))
    assert f"{kind} image" in sentence
    assert "centroids, not images" in sentence
    assert "UTF-8" not in sentence


@pytest.mark.parametrize("kind", OTHERS)
def test_another_file_is_called_what_it_is(read, kind):
    for name in ("pass.csv", "pass.jsonl", "pass.parquet", "pass"):
        sentence = str(refused(read, OTHERS[kind], name))
        assert kind in sentence
        assert "UTF-8" not in sentence


@pytest.mark.parametrize("kind", [*IMAGES, *OTHERS])
def test_a_sensor_file_that_is_another_file_is_called_what_it_is(kind, tmp_path):
    path = tmp_path / "sensor.json"
    path.write_bytes({**IMAGES, **OTHERS}[kind])
    with pytest.raises(RefusedInputError, match=kind) as caught:
        read_sensor(path)
    assert "UTF-8" not in str(caught.value)


def test_parquet_is_no_json():
    with pytest.raises(RefusedInputError, match="Parquet"):
        read_text("sensor.json", b"PAR1\x15\x04")


@pytest.mark.parametrize("first", ["ORCa", "BZh", "FEA1", "Obj"])
def test_a_column_may_be_called_as_a_signature_is(read, first):
    text = GOOD.replace("star_id", f"{first},star_id")
    header, *rows = text.strip().split("\n")
    names = header.split(",")
    cells = [row.split(",") for row in rows]
    order = [names.index(first), *(k for k in range(len(names)) if names[k] != first)]
    cells = [[*row[:4], "7", *row[4:]] for row in cells]
    moved = "\n".join(",".join(line[k] for k in order) for line in [names, *cells])
    assert read(moved, "pass.csv").unknown[first].to_pylist() == ["7"] * len(rows)
