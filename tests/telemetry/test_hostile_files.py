"""Files made to exhaust whoever reads them end in a result or a sentence, soon and in little memory; none ends the process."""

import contextlib
import json
import subprocess
import sys

import numpy as np
import pytest

from boresight.errors import RefusedInputError
from boresight.telemetry.read.readers import read_telemetry
from tests.telemetry import hostile_files
from tests.telemetry.files import GOOD

MOST_S, MOST_MB = 5.0, 500.0
#: Made quickly, one of each kind of trouble; the others run with --full.
QUICK = (
    "header of 100,000 columns.csv",
    "996 columns of nothing.csv",
    "every quote unclosed.csv",
    "blank lines for ever.csv",
    "exposures of 10,000 stars in a line.csv",
    "arrays nested over lines.jsonl",
    "a thousand keys, then empty lines.jsonl",
    "text of 4000 bytes in a million rows.parquet",
    "pages larger than they are.parquet",
    "64 bits flipped.parquet",
)


@pytest.fixture(scope="module")
def reading():
    command = [sys.executable, "-m", "tests.telemetry.reading_process"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"

        def read(path):
            process.stdin.write(f"{path}\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield read
        process.stdin.close()


def names():
    assert len(hostile_files.FILES) >= 100
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.full) for name in hostile_files.FILES]


@pytest.mark.parametrize("name", names())
def test_a_hostile_file_ends_soon_and_in_little_memory(name, reading, tmp_path):
    path = tmp_path / name
    path.write_bytes(hostile_files.content(name))
    done = reading(path)
    assert done["outcome"][0] in {"accepted", "refused"}, done
    assert done["cpu_s"] < MOST_S
    assert done["peak_mb"] < MOST_MB


#: Seeds among whose files are footers over which Arrow ended the process when it was asked for a column of a group of rows.
ENDED_THE_PROCESS = (13, 35)


def mutated(rng):
    kind = rng.choice(["csv", "jsonl", "parquet"])
    if kind == "csv":
        data = GOOD.encode() * 1
    elif kind == "jsonl":
        data = b'{"frame":0,"exposure":0,"row_px":1.5,"col_px":2,"note":"a","time_utc":"2026-01-01T00:00:00Z"}\n' * 4
    else:
        options = [
            {},
            {"use_dictionary": False},
            {"data_page_version": "2.0"},
            {"compression": "gzip"},
            {"row_group_size": 7},
        ]
        columns = {
            **hostile_files.rows_of(60),
            "note": ["a", "bb", "ccc"] * 20,
            "time_utc": ["2026-01-01T00:00:00Z"] * 60,
        }
        data = hostile_files.parquet(columns, **options[rng.integers(len(options))])
    data = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 2, 4, 16]))):
        place = int(rng.integers(len(data)))
        match rng.integers(4):
            case 0:
                data[place] ^= 1 << int(rng.integers(8))
            case 1:
                data[place] = int(rng.integers(256))
            case 2:
                del data[place : place + int(rng.integers(1, 9))]
            case _:
                data[place:place] = data[place : place + int(rng.integers(1, 30))]
        if not data:
            break
    return f"pass.{kind}", bytes(data)


@pytest.mark.parametrize(
    "seed",
    [
        0,
        *ENDED_THE_PROCESS,
        *(pytest.param(seed, marks=pytest.mark.full) for seed in range(1, 40) if seed not in ENDED_THE_PROCESS),
    ],
)
def test_fifty_mutated_files_are_read_or_refused_in_words(seed, tmp_path):
    rng = np.random.default_rng(seed)
    for _ in range(50):
        name, data = mutated(rng)
        (tmp_path / name).write_bytes(data)
        with contextlib.suppress(RefusedInputError):  # anything else fails the test
            read_telemetry(tmp_path / name)
