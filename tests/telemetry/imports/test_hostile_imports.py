"""Files that would exhaust whoever imports them end soon, in little memory, in a refusal or in telemetry."""

import contextlib
import gzip
import io
import json
import subprocess
import sys
import time
import zipfile
import zlib

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from boresight.errors import RefusedInputError
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.mapping import import_files
from tests.effort import effort
from tests.refusals import has_code
from tests.telemetry.imports.conftest import VECTORS, source

VOTABLE = (
    '<?xml version="1.0"?>{dtd}<VOTABLE version="1.3"><RESOURCE><TABLE {nrows}>'
    '<FIELD name="row_px" datatype="double" {size}/><FIELD name="col_px" datatype="double"/>{fields}<DATA>{data}</DATA></TABLE>'
    "</RESOURCE></VOTABLE>"
)
ROWS = "<TABLEDATA><TR><TD>1</TD><TD>2</TD></TR></TABLEDATA>"
ENTITIES = '<!DOCTYPE x [<!ENTITY a "' + "ha" * 1000 + '">' + "".join(
    f'<!ENTITY a{k} "{"&a;" if k == 0 else f"&a{k - 1};"}' * 1 + f'{"&a;" if k == 0 else f"&a{k - 1};" * 20}">' for k in range(8)
) + "]>"  # fmt: skip


def votable(**parts):
    return VOTABLE.format(**{"dtd": "", "nrows": "", "fields": "", "size": "", "data": ROWS, **parts}).encode()


def announced_fits(rows):
    """A FITS table whose header says more rows than there are."""
    written = io.BytesIO()
    Table({"X": [1.0], "Y": [2.0]}).write(written, format="fits")
    return written.getvalue().replace(b"NAXIS2  =                    1", b"NAXIS2  = %20d" % rows)


FILES = {
    "entities.xml": lambda: votable(dtd=ENTITIES),
    "rows elsewhere.xml": lambda: votable(data='<BINARY><STREAM href="file:///etc/passwd"/></BINARY>'),
    "rows on the net.xml": lambda: votable(
        data='<BINARY><STREAM\n encoding="gzip"\n href="http://localhost:9/x"/></BINARY>'
    ),
    "rows elsewhere, after a value with a bracket.xml": lambda: votable(
        data='<BINARY><STREAM actuate=">" href="file:///etc/passwd"/></BINARY>'
    ),
    "streams without an end.xml": lambda: votable(data="<!--" + "STREAM " * 1_000_000 + "-->"),
    "rows of nothing.xml": lambda: votable(
        data="<TABLEDATA>" + "<TR/>" * 700_000 + "</TABLEDATA>", fields='<FIELD name="x" datatype="double"/>' * 900
    ),
    "a billion rows.xml": lambda: votable(nrows='nrows="1000000000"'),
    "a cell of a billion.xml": lambda: votable(size='arraysize="1000000000"'),
    "deep.xml": lambda: b"<VOTABLE>" + b"<RESOURCE>" * 200_000,
    "more rows than bytes.fits": lambda: announced_fits(2_000_000_000),
    "half a table.fits": lambda: (VECTORS / "astrometry-net.corr").read_bytes()[:7000],
    "half a header.fits": lambda: (VECTORS / "astrometry-net.corr").read_bytes()[:3000],
    "no table.fits": lambda: bytes(fits.PrimaryHDU(np.zeros((4, 4))).header.tostring(), "ascii") + bytes(2880),
    "deep.json": lambda: b'{"matched_centroids":' + b"[" * 500_000,
    "a million lists.json": lambda: b'{"matched_centroids":[' + b"[1,2]," * 1_000_000 + b"[1,2]]}",
    "wide objects.json": lambda: json.dumps(
        [{f"k{k}_{n}": k for k in range(500)} | {"matched_centroids": [[1, 2]]} for n in range(60)]
    ).encode(),
    "one object for all.json": lambda: json.dumps(
        {"matched_centroids": [[1, 2]] * 10_000} | {f"k{k}": 1 for k in range(100_000)}
    ).encode(),
    "long names.json": lambda: json.dumps(
        {"matched_centroids": [[1, 2]], "k" * 100_000: {f"k{k}": 1 for k in range(100_000)}}
    ).encode(),
    "one long line.csv": lambda: b"1," * 5_000_000,
    "a million cells.cat": lambda: b"#   1 X_IMAGE  x [pixel]\n#   2 Y_IMAGE y [pixel]\n" + b"1 2 " * 250_000,
    "columns.cat": lambda: b"".join(b"# %d C%d x\n" % (k, k) for k in range(1, 30_000)) + b"1 2\n",
    "a column of a large number.cat": lambda: b"#   1 X_IMAGE  x\n# 99999999999 Y_IMAGE y\n1 2\n",
    "quotes.tsv": lambda: b"Time\tSTAR1_ROW\tSTAR1_COL\n" + b'"' * 1_000_000,
    "gzip.fits": lambda: zlib.compress(b"SIMPLE  ="),
}
PROFILES = {
    "xml": "contract",
    "fits": "astrometry-xyls",
    "json": "tetra3",
    "csv": "openstartracker",
    "cat": "sextractor",
    "tsv": "yamcs",
}
MOST_S, MOST_MB = 5.0, 500.0


def in_a_process(path, profile):
    code = (
        "import re, sys, time\n"
        "from pathlib import Path\n"
        "from boresight.errors import RefusedInputError\n"
        "from boresight.telemetry.imports.builtin import BUILT_IN\n"
        "from boresight.telemetry.imports.mapping import SourceFile, import_files\n"
        "import astropy.io.fits, astropy.io.ascii, astropy.io.votable\n"
        "for line in sys.stdin:\n"
        "    path, profile = line.rstrip('\\n').split('\\t')\n"
        "    start = time.process_time()\n"
        "    try:\n"
        "        import_files([SourceFile(Path(path), Path(path).name)], BUILT_IN[profile]); said = 'accepted'\n"
        "    except RefusedInputError as error:\n"
        "        said = 'refused'\n"
        "    peak = re.search(r'VmHWM:\\s+(\\d+)', Path('/proc/self/status').read_text())\n"
        "    print(said, time.process_time() - start, int(peak[1]) / 1e3, flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        process.stdin.write("".join(f"{one}\t{other}\n" for one, other in zip(path, profile, strict=True)))
        process.stdin.close()
        return [line.split() for line in process.stdout]


def test_hostile_files_are_refused_soon_and_in_little_memory(tmp_path):
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content())
    began = time.monotonic()
    done = in_a_process([tmp_path / name for name in FILES], [PROFILES[name.rsplit(".", 1)[1]] for name in FILES])
    assert len(done) == len(FILES), done
    for name, (said, cpu_s, peak_mb) in zip(FILES, done, strict=True):
        assert said == "refused", name
        assert float(cpu_s) < MOST_S, (name, cpu_s)
        assert float(peak_mb) < MOST_MB, (name, peak_mb)
    assert time.monotonic() - began < 60


@pytest.mark.parametrize(
    ("name", "profile"),
    [
        ("astrometry-net.corr", "astrometry-corr"),
        ("sextractor.cat", "sextractor"),
        ("cedar-solve.json", "tetra3"),
        ("photutils.ecsv", "photutils"),
        ("openstartracker.csv", "openstartracker"),
    ],
)
def test_damaged_files_are_read_or_refused_in_words(tmp_path, name, profile):
    rng = np.random.default_rng(4)
    good = (VECTORS / name).read_bytes()
    for _ in range(effort(15, 300)):
        data = bytearray(good)
        for _ in range(int(rng.choice([1, 2, 8]))):
            place = int(rng.integers(len(data)))
            match rng.integers(3):
                case 0:
                    data[place] = int(rng.integers(256))
                case 1:
                    del data[place : place + int(rng.integers(1, 200))]
                case _:
                    data[place:place] = bytes(rng.integers(32, 127, int(rng.integers(1, 30)), dtype=np.uint8))
            if not data:
                break
        (tmp_path / name).write_bytes(bytes(data))
        with contextlib.suppress(RefusedInputError):
            import_files([source(tmp_path / name)], BUILT_IN[profile])


POINTS = {"row": {"column": "r"}, "col": {"column": "c"}, "frames": {"by": "record"}}


def test_a_packed_fits_is_not_expanded_by_a_profile_that_names_fits(load):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.fits", bytes(10_000_000))
    with pytest.raises(RefusedInputError, check=has_code("not-fits")):
        load(packed.getvalue(), POINTS | {"layout": {"format": "fits"}}, "a.dat")


def test_a_fits_table_compressed_by_gzip_is_expanded_up_to_its_budget(load):
    named = {"row": {"column": "Y"}, "col": {"column": "X"}, "frames": {"by": "file"}, "layout": {"format": "fits"}}
    assert load(gzip.compress(announced_fits(1)), named, "a.dat").telemetry.row_px.tolist() == [2.0]
    with pytest.raises(RefusedInputError, check=has_code("expands-too-far")):
        load(gzip.compress(announced_fits(1) + bytes(100_000_000)), named, "a.dat")


def test_a_long_cell_of_a_ragged_line_is_refused_by_its_row(load):
    ragged = {"layout": {"format": "ragged", "cells_per_star": 2}, "row": {"column": "1"}, "col": {"column": "2"}}
    with pytest.raises(RefusedInputError, match="row 2"):
        load("1,2\n1," + "2" * 200_000 + "\n", POINTS | ragged)


def test_rows_are_chosen_by_a_column_with_one_long_text(load):
    content = "r,c,k\n1,1," + "x" * 4000 + "\n" + "1,1,a\n" * 300_000
    assert len(load(content, POINTS | {"layout": {"where": {"k": ["a"]}}}).telemetry) == 300_000
