"""What we ask of Yamcs, beside what its own client library does on the same server: the stand-in, and a real one if named."""

import dataclasses
import datetime as dt
import io
import json
import os
import time
from contextlib import closing

import numpy as np
import pytest
from click.testing import CliRunner
from yamcs.client import YamcsClient
from yamcs.client.core.auth import Credentials
from yamcs.client.tmtc.model import ValueUpdate

from boresight.cli import main
from boresight.errors import RefusedInputError, UnavailableError
from boresight.mission_control import connection as budgets
from boresight.mission_control.archive import count_us
from boresight.mission_control.connection import TooMuchError
from boresight.mission_control.systems import Link
from boresight.mission_control.yamcs import YamcsEvent
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.profile import parse_profile
from boresight.telemetry.readers import read_telemetry
from tests.mission_control.yamcs_stand_in import BUCKET, INSTANCE, STARS, YamcsStandIn, serving

REAL = os.environ.get("BORESIGHT_YAMCS_SERVER")
BEGIN = dt.datetime.now(dt.UTC).replace(microsecond=0) - dt.timedelta(
    hours=2
)  # a real server keeps what former runs left
SECOND = dt.timedelta(seconds=1)


def profile_of(**changed):
    text = json.dumps({**BUILT_IN["yamcs"].to_dict(), "name": "tracker-a", **changed})
    for begins in ("STAR{n}", "Q_", "TEMPERATURE"):
        text = text.replace(f'"{begins}', f'"/TRK/{begins}')
    return parse_profile(json.loads(text))


PROFILE = profile_of()


@pytest.fixture
def stand_in():
    return YamcsStandIn()


@pytest.fixture
def address(stand_in):
    with serving(stand_in.app) as found:
        yield found


@pytest.fixture(
    params=["stand-in", pytest.param("real", marks=pytest.mark.skipif(not REAL, reason="no BORESIGHT_YAMCS_SERVER"))]
)
def server(request, address):
    return address if request.param == "stand-in" else REAL


def link(address, **changed):
    return dataclasses.replace(Link("yamcs", address, INSTANCE, BUCKET), **changed)


@pytest.fixture
def ours(server):
    with closing(link(server).open_events()) as opened:
        yield opened


@pytest.fixture
def client(server):
    with closing(YamcsClient(server)) as opened:
        yield opened


def load(client, rows):
    """Archive rows as a ground station's software does, through the client library."""
    updates = ({name: ValueUpdate(value, generation_time=at) for name, value in values.items()} for at, values in rows)
    client.load_parameter_values(INSTANCE, updates, stream="pp_realtime")
    time.sleep(0.0 if REAL is None else 2.0)


def at(seconds):
    return BEGIN + seconds * SECOND


def export(ours, start, stop, profile=PROFILE):
    return ours.export(profile, count_us(at(start)), count_us(at(stop)))


def test_an_export_is_what_the_client_library_lists_value_for_value(ours, client):
    stars = [
        (at(k), {"/TRK/STAR1_ROW": 10.0 + k / 7, "/TRK/STAR1_COL": 0.1 * k, "/TRK/TEMPERATURE": 20.5}) for k in range(8)
    ]
    packets = [(at(k + 0.25), {f"/TRK/Q_{axis}": float(axis == "W") for axis in "XYZW"}) for k in range(8)]
    load(client, sorted(stars + packets, key=lambda row: row[0]))
    rows = export(ours, 0, 100)
    assert rows.times_us.tolist() == [count_us(at(k + quarter)) for k in range(8) for quarter in (0, 0.25)]
    names = rows.header.split("\t")
    archive = client.get_archive(INSTANCE)
    for name in ("/TRK/STAR1_ROW", "/TRK/STAR1_COL", "/TRK/Q_W", "/TRK/TEMPERATURE"):
        listed = archive.list_parameter_values(name, start=at(0), stop=at(100), parameter_cache=None)
        place = names.index(name)
        found = [(when, line.split("\t")[place]) for when, line in zip(rows.times_us, rows.lines, strict=True)]
        assert [(when, float(cell)) for when, cell in found if cell] == [
            (count_us(one.generation_time), one.eng_value) for one in listed
        ]
    exported = b"".join(archive.export_parameter_values(names[1:], start=at(0), stop=at(100))).decode().splitlines()
    assert list(rows.lines) == exported[1:]


def test_a_range_holds_its_start_and_not_its_stop_so_neighbours_share_no_row(ours, client):
    load(client, [(at(1000 + k / 4), {"/TRK/STAR1_ROW": float(k), "/TRK/STAR1_COL": 1.0}) for k in range(12)])
    parts = [export(ours, 1000 + k / 2, 1000.5 + k / 2).times_us.tolist() for k in range(6)]
    assert [len(part) for part in parts] == [2] * 6
    assert [row for part in parts for row in part] == export(ours, 1000, 1010).times_us.tolist()
    cut = ours.export(PROFILE, count_us(at(1000)) + 1, count_us(at(1000.25)))  # Yamcs rounds the start down
    assert cut.times_us.tolist() == []


def test_rows_that_were_taken_are_left_out_of_the_next_export(ours, client):
    load(client, [(at(2000 + k), {"/TRK/STAR1_ROW": float(k), "/TRK/STAR1_COL": 1.0}) for k in range(0, 10, 2)])
    first = export(ours, 2000, 2010)
    load(client, [(at(2000 + k), {"/TRK/STAR1_ROW": float(k), "/TRK/STAR1_COL": 1.0}) for k in range(1, 10, 2)])
    late = export(ours, 2000, 2010).without(first.times_us)
    assert late.times_us.tolist() == [count_us(at(2000 + k)) for k in range(1, 10, 2)]
    assert late.to_bytes().decode().count("\n") == 6


def test_an_event_that_is_sent_twice_is_one_event_and_the_client_library_reads_it(ours, client):
    number = int(BEGIN.timestamp()) % 10**6
    event = YamcsEvent(
        f"{at(3000):%Y-%m-%dT%H:%M:%S.%f}Z", number, "alarms.raised", "CRITICAL", "It moved.", {"object": "alarms/3"}
    )
    for _ in range(2):
        ours.post_event(event)
    time.sleep(0.0 if REAL is None else 1.0)
    found = [
        one for one in client.get_archive(INSTANCE).list_events(source="Boresight") if one.sequence_number == number
    ]
    assert [(one.message, one.severity, one.event_type, dict(one.extra)) for one in found] == [
        ("It moved.", "CRITICAL", "alarms.raised", {"object": "alarms/3"})
    ]
    assert found[0].generation_time == at(3000)


def test_a_table_lies_in_the_bucket_byte_for_byte_once_whoever_hands_it_over_again(server, client):
    image = bytes(range(256)) * 3
    places = [link(server).hand_over("PS-ST-1-3", "0f" * 32, {"table.bin": image}) for _ in range(2)]
    assert places == [("boresight/PS-ST-1-3/0f0f0f0f0f0f/table.bin",)] * 2
    assert client.get_storage_client().download_object(BUCKET, "PS-ST-1-3/0f0f0f0f0f0f/table.bin") == image
    with pytest.raises(RefusedInputError):
        link(server, store="elsewhere").hand_over("PS-ST-1-3", "0f" * 32, {"table.bin": image})
    with pytest.raises(RefusedInputError):
        link(server).hand_over("PS-ST-1-3", "0f" * 32, {"summary.json": b"{}"})


def test_what_the_client_library_uploads_is_what_we_would(address, stand_in):
    image = b"\0\1\2\xff"
    with closing(YamcsClient(address)) as client:
        client.get_storage_client().upload_object(BUCKET, "theirs", io.BytesIO(image))
    with closing(link(address).open_events()) as ours:
        ours.store_object(BUCKET, "ours", image)
    assert stand_in.objects["ours"] == stand_in.objects["theirs"] == image


def test_names_that_the_archive_does_not_have_are_refused_unless_the_profile_can_do_without(ours):
    document = PROFILE.to_dict()
    with pytest.raises(RefusedInputError, match="/TRK/NOPE"):
        export(ours, 0, 1, parse_profile({**document, "row": {"column": "/TRK/NOPE"}}))
    with pytest.raises(RefusedInputError, match="STAR1_ROW"):
        export(ours, 0, 1, BUILT_IN["yamcs"])
    header = export(ours, 0, 1, parse_profile({**document, "magnitude": {"column": "/TRK/NOPE"}})).header
    assert "/TRK/NOPE" not in header
    assert header.count("_ROW") == STARS


def test_a_telemetry_set_that_was_archived_is_pulled_as_it_was(server, client, catalogue, tmp_path, monkeypatch):
    scenario = dataclasses.replace(calibration_scenario(1), frames=6)
    made = simulate(scenario, np.random.default_rng(4), catalogue)
    rows = []
    for number, frame in enumerate(np.unique(made.frame)):
        stars = np.flatnonzero(made.frame == frame)[:STARS]
        values = {
            f"/TRK/STAR{n}_{what}": float(value)
            for n, star in enumerate(stars, 1)
            for what, value in (("ROW", made.row_px[star]), ("COL", made.col_px[star]), ("ID", made.star_id[star]))
        }
        values |= {f"/TRK/Q_{axis}": float(q) for axis, q in zip("XYZW", made.quaternion[stars[0]], strict=True)}
        rows.append((at(4000 + number), values))
    load(client, rows)
    (tmp_path / "tracker.json").write_text(json.dumps(PROFILE.to_dict()))
    monkeypatch.setenv("BORESIGHT_YAMCS_URL", server)
    monkeypatch.setenv("BORESIGHT_YAMCS_INSTANCE", INSTANCE)
    asked = [
        "--start",
        at(4000).isoformat(),
        "--stop",
        at(4100).isoformat(),
        "--profile",
        str(tmp_path / "tracker.json"),
    ]
    done = CliRunner().invoke(main, ["yamcs", "pull", *asked, "--out", str(tmp_path / "pass.csv")])
    assert done.exit_code == 0, done.output
    pulled = read_telemetry(tmp_path / "pass.csv")
    expected = [
        (v[f"/TRK/STAR{n}_ROW"], v[f"/TRK/STAR{n}_COL"], int(v[f"/TRK/STAR{n}_ID"]))
        for _, v in rows
        for n in range(1, STARS + 1)
        if f"/TRK/STAR{n}_ROW" in v
    ]
    assert list(zip(pulled.row_px.tolist(), pulled.col_px.tolist(), pulled.star_id.tolist(), strict=True)) == expected
    assert len(np.unique(pulled.frame)) == 6
    nothing = CliRunner().invoke(
        main,
        [
            "yamcs",
            "pull",
            "--start",
            "1999-01-01",
            "--stop",
            "1999-01-02",
            *asked[4:],
            "--out",
            str(tmp_path / "n.csv"),
        ],
    )
    assert (nothing.exit_code, (tmp_path / "n.csv").exists()) == (1, False)


def test_name_and_password_or_a_key_let_us_in_and_never_go_over_a_line_in_the_clear(tmp_path):
    stand_in = YamcsStandIn({"boresight": "secret"})
    with serving(stand_in.app) as address:
        for secret, allowed in (
            ("boresight:secret", True),
            ("secret", True),
            ("boresight:wrong", False),
            ("wrong", False),
        ):
            (tmp_path / "credentials").write_text(f"{secret}\n")
            with closing(link(address, credentials=str(tmp_path / "credentials")).open()) as opened:
                if allowed:
                    assert opened.export(PROFILE, 0, 1).lines == []
                else:
                    with pytest.raises(UnavailableError, match="BORESIGHT_YAMCS_CREDENTIALS"):
                        opened.export(PROFILE, 0, 1)
        with closing(link(address).open()) as opened, pytest.raises(UnavailableError):
            opened.export(PROFILE, 0, 1)
        credentials = Credentials(username="boresight", password="secret")
        with closing(YamcsClient(address, credentials=credentials, keep_alive=False)) as client:
            assert list(client.get_archive(INSTANCE).list_events()) == []
    with pytest.raises(RefusedInputError, match="https"):
        link("http://yamcs.example", credentials=str(tmp_path / "credentials")).open()
    with pytest.raises(RefusedInputError, match="CREDENTIALS"):
        link("https://yamcs.example", credentials=str(tmp_path / "nowhere")).open()


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        ({"status": 500}, UnavailableError),
        ({"status": 503}, UnavailableError),
        ({"status": 403}, UnavailableError),
        ({"status": 302}, UnavailableError),
        ({"status": 400}, RefusedInputError),
        ({"truncates": True}, UnavailableError),
        ({"flood_mb": 3}, TooMuchError),
        ({"drip_s": 1.5}, UnavailableError),
    ],
)  # fmt: skip
def test_a_server_that_fails_is_one_sentence_and_nothing_is_kept(address, stand_in, monkeypatch, fault, error):
    monkeypatch.setattr(budgets, "TIMEOUT_S", 0.5)
    monkeypatch.setattr("boresight.mission_control.yamcs.MOST_EXPORT_BYTES", 2_000_000)
    for name, value in fault.items():
        setattr(stand_in, name, value)
    with closing(link(address).open()) as ours, pytest.raises(error) as refused:
        ours.export(PROFILE, 0, 10)
    assert "\n" not in str(refused.value)
    assert str(refused.value).endswith(".")


def test_a_certificate_of_nobody_we_trust_is_refused_and_a_closed_port_named(tmp_path):
    with pytest.raises(UnavailableError, match="BORESIGHT_YAMCS_URL"):
        link("http://127.0.0.1:9").open().export(PROFILE, 0, 1)
    (tmp_path / "authority.pem").write_text("nothing")
    with pytest.raises(RefusedInputError, match="AUTHORITY"):
        link("https://127.0.0.1:9", authority=str(tmp_path / "authority.pem")).open()
