"""Files that would exhaust whoever imports them end soon, in little memory, in a refusal or in telemetry."""

import contextlib
import io
import json
import subprocess
import sys
import time
import zlib

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from boresight.errors import RefusedInputError
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.mapping import import_files
from tests.effort import effort
from tests.telemetry.imports.conftest import VECTORS, source

VOTABLE = (
    '<?xml version="1.0"?>{dtd}<VOTABLE version="1.3"><RESOURCE><TABLE {nrows}>'
    '<FIELD name="row_px" datatype="double" {size}/><FIELD name="col_px" datatype="double"/><DATA>{data}</DATA></TABLE>'
    "</RESOURCE></VOTABLE>"
)
ROWS = "<TABLEDATA><TR><TD>1</TD><TD>2</TD></TR></TABLEDATA>"
ENTITIES = '<!DOCTYPE x [<!ENTITY a "' + "ha" * 1000 + '">' + "".join(
    f'<!ENTITY a{k} "{"&a;" if k == 0 else f"&a{k - 1};"}' * 1 + f'{"&a;" if k == 0 else f"&a{k - 1};" * 20}">' for k in range(8)
) + "]>"  # fmt: skip


def votable(**parts):
    return VOTABLE.format(**{"dtd": "", "nrows": "", "size": "", "data": ROWS, **parts}).encode()


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
    "one long line.csv": lambda: b"1," * 5_000_000,
    "a million cells.cat": lambda: b"#   1 X_IMAGE  x [pixel]\n#   2 Y_IMAGE y [pixel]\n" + b"1 2 " * 250_000,
    "columns.cat": lambda: b"".join(b"# %d C%d x\n" % (k, k) for k in range(1, 30_000)) + b"1 2\n",
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
