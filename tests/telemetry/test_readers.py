"""Good files are read to the last digit, whatever their form; spoilt ones are read or refused and nothing else."""

import contextlib
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.telemetry.read.readers import read_telemetry, write_csv, write_parquet
from boresight.telemetry.schema import Telemetry
from tests.effort import effort
from tests.strategies import telemetry_tables
from tests.telemetry.files import GOOD, MINIMAL, parquet_bytes, with_columns


def test_a_csv_file_is_read_with_unmatched_stars_as_zero(read):
    telemetry = read(GOOD)
    assert telemetry.frame.tolist() == [0, 0, 0, 1]
    assert telemetry.exposure.tolist() == [0, 0, 1, 0]
    assert telemetry.col_px.tolist() == [20.25, 40.25, 20.25, 60.0]
    assert telemetry.star_id.tolist() == [11, 0, 11, 0]
    assert telemetry.magnitude is None
    assert telemetry.first_row == 2


@pytest.mark.parametrize(
    "change",
    [
        lambda text: b"\xef\xbb\xbf" + text.encode(),
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: text.replace("\n", "\r").encode(),
        lambda text: text.rstrip("\n").encode(),
        lambda text: (text + "\n\n  \n").encode(),
        lambda text: text.replace(",", " , ").encode(),
        lambda text: text.replace("10.5", "+10.5").encode(),
        lambda text: text.replace("10.5", '"10.5"').encode(),
        lambda text: text.replace(",11", ",11.0").encode(),
    ],
    ids=["byte-order mark", "CRLF", "CR", "no last line end", "blank end", "blanks", "plus", "quotes", "11.0"],
)
def test_harmless_ways_of_writing_csv_are_let_pass(read, change):
    telemetry = read(change(GOOD))
    assert telemetry.row_px.tolist() == [10.5, 30.5, 10.5, 50.0]
    assert telemetry.star_id.tolist() == [11, 0, 11, 0]


def test_json_lines_are_read_with_null_as_absent(read):
    telemetry = read(
        '{"frame":3,"exposure":0,"row_px":1.5,"col_px":2,"star_id":null,"time_utc":"2024-02-29T12:00:00Z","note":"2024-01-01"}\n'
        '{"frame":3,"exposure":1,"row_px":1.5,"col_px":2,"star_id":7,"time_utc":null,"note":null}\n',
        "pass.jsonl",
    )
    assert telemetry.star_id.tolist() == [0, 7]
    assert telemetry.time_utc[0] == np.datetime64("2024-02-29T12:00:00", "us")
    assert np.isnat(telemetry.time_utc[1])
    assert telemetry.unknown["note"].to_pylist() == ["2024-01-01", ""]
    assert telemetry.ra_rad is None
    assert telemetry.first_row == 1


@pytest.mark.parametrize("name", ["blob", "pass.telemetry"])
def test_a_file_of_no_known_suffix_is_what_its_bytes_are(read, tmp_path, name):
    expected = read(GOOD, name)
    write_parquet(expected, tmp_path / "address")
    assert read_telemetry(tmp_path / "address").row_px.tolist() == expected.row_px.tolist()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2019-07-29T20:47:26Z", "2019-07-29T20:47:26"),
        ("2019-07-29T20:47:26.123456", "2019-07-29T20:47:26.123456"),
        ("2019-07-29 20:47:26", "2019-07-29T20:47:26"),
        ("2019-07-29T22:47:26+02:00", "2019-07-29T20:47:26"),
    ],
)
def test_times_are_iso_8601_and_utc_where_they_name_no_zone(read, text, expected):
    telemetry = read(with_columns("time_utc", text))
    assert telemetry.time_utc[0] == np.datetime64(expected, "us")


def test_units_become_si_and_unknown_columns_are_kept_as_they_came(read):
    telemetry = read(with_columns("ra_deg,dec_deg,vx_km_s,vy_km_s,vz_km_s", "180,-45,7.5,0,-0.001"))
    assert telemetry.ra_rad[0] == pytest.approx(np.pi)
    assert telemetry.dec_rad[0] == pytest.approx(-np.pi / 4)
    assert telemetry.velocity_m_s[0] == pytest.approx([7500.0, 0.0, -1.0])
    telemetry = read(with_columns("flux,note", '0012.50,"a, b"'))
    assert texts_of(telemetry) == {"flux": ["0012.50"], "note": ["a, b"]}


def texts_of(telemetry: Telemetry) -> dict[str, list[str]]:
    return {name: cells.to_pylist() for name, cells in telemetry.unknown.items()}


def assert_same(one: Telemetry, other: Telemetry) -> None:
    for name in (
        "frame",
        "exposure",
        "row_px",
        "col_px",
        "time_utc",
        "magnitude",
        "sigma_px",
        "star_id",
        "temperature_c",
    ):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name in ("ra_rad", "dec_rad", "quaternion", "velocity_m_s"):
        left, right = getattr(one, name), getattr(other, name)
        assert (left is None) == (right is None), name
        if left is not None:
            np.testing.assert_allclose(left, right, rtol=1e-15, atol=1e-300, err_msg=name)
    assert texts_of(one) == texts_of(other)


@settings(
    max_examples=effort(12, 60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(telemetry=telemetry_tables())
def test_what_is_written_is_read_back(telemetry, tmp_path):
    write_csv(telemetry, tmp_path / "pass.csv")
    write_parquet(telemetry, tmp_path / "pass.parquet")
    assert_same(read_telemetry(tmp_path / "pass.csv"), telemetry)
    assert_same(read_telemetry(tmp_path / "pass.parquet"), telemetry)


JSON_LINES = "".join(
    f'{{"frame":{k},"exposure":0,"row_px":{k}.5,"col_px":2,"star_id":{k + 1},"time_utc":"2024-01-01","note":"x"}}\n'
    for k in range(4)
)
VALID = {"pass.csv": GOOD.encode(), "pass.jsonl": JSON_LINES.encode(), "pass.parquet": parquet_bytes(MINIMAL)}
DIRT = [
    b'"', b",", b"\n", b"\r", b"\0", b"nan", b"\xff", b"{", b"}", b"[", b"1e999", b"", b"\\", b"null", b"9" * 400, b'"\n"',
]  # fmt: skip


@settings(max_examples=effort(60, 300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(sorted(VALID)),
    spoils=st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 20), st.sampled_from(DIRT) | st.binary(max_size=4)), min_size=1
    ),
)
def test_a_spoilt_file_is_read_or_refused_and_nothing_else(name, spoils, tmp_path):
    content = bytearray(VALID[name])
    for place, length, dirt in spoils:
        start = int(place * len(content))
        content[start : start + length] = dirt
    (tmp_path / name).write_bytes(content)
    with contextlib.suppress(RefusedInputError):
        assert len(read_telemetry(tmp_path / name)) > 0


def test_twenty_thousand_frames_of_24_stars_are_read_in_seconds(tmp_path):
    n = 480_000
    rng = np.random.default_rng(7)
    frame = np.repeat(np.arange(20_000), 24)
    telemetry = Telemetry(
        frame=frame,
        exposure=np.tile(np.repeat([0, 1], 12), 20_000),
        row_px=rng.uniform(0, 1943, n),
        col_px=rng.uniform(0, 2591, n),
        time_utc=np.datetime64("2024-01-01", "us") + frame * 500_000,
        star_id=np.arange(n) % 118_000 + 1,
    )
    write_csv(telemetry, tmp_path / "long.csv")
    begin = time.process_time()
    read_telemetry(tmp_path / "long.csv")
    assert time.process_time() - begin < 4.0  # of processor time: what else the machine does does not count


def test_the_real_star_fields_are_read(real_sky):
    telemetry = read_telemetry(real_sky / "esa-5-frames.csv")
    assert len(telemetry) == 873
    assert np.unique(telemetry.frame).tolist() == [0, 1, 2, 3, 4]
    assert int((telemetry.star_id > 0).sum()) == int(np.isfinite(telemetry.ra_rad).sum()) == 596
    assert set(telemetry.time_utc) == {np.datetime64("2019-07-29T20:47:26", "us")}
