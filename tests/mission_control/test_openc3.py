"""Telemetry out of OpenC3's history by its JSON API, and files into a target, against a stand-in that follows the published API."""

import dataclasses
import datetime as dt
import json
import sys
from contextlib import closing

import pytest
from click.testing import CliRunner

from boresight.cli import main
from boresight.errors import RefusedInputError, UnavailableError
from boresight.mission_control.archive import count_us
from boresight.mission_control.systems import Link
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.profile import parse_profile
from boresight.telemetry.readers import read_telemetry
from tests.mission_control.openc3_stand_in import OpenC3StandIn
from tests.mission_control.yamcs_stand_in import serving

BEGIN = dt.datetime(2026, 11, 20, 1, 0, 0, 250, dt.UTC)


def profile_document():
    text = json.dumps({**BUILT_IN["openc3"].to_dict(), "name": "tracker-a"})
    for begins, packet in (("STAR{n}", "STARS"), ("Q_", "ATTITUDE"), ("TEMPERATURE", "STARS")):
        text = text.replace(f'"{begins}', f'"TRK {packet} {begins}')
    return json.loads(text)


PROFILE = parse_profile(profile_document())


def at(seconds):
    return BEGIN + dt.timedelta(seconds=seconds)


@pytest.fixture
def openc3():
    made = OpenC3StandIn()
    made.packets["TRK", "STARS"] = [
        (at(k), {"STAR1_ROW": 10.5 + k, "STAR1_COL": 20.25, "STAR2_ROW": 30 + k, "STAR2_COL": 40, "TEMPERATURE": 20.5})
        for k in range(5)
    ]
    made.packets["TRK", "ATTITUDE"] = [
        (at(k + 0.5), {f"Q_{axis}": float(axis == "W") for axis in "XYZW"}) for k in range(-1, 5)
    ]
    return made


@pytest.fixture
def address(openc3):
    with serving(openc3.app) as found:
        yield found


def export(address, start, stop, **changed):
    with closing(dataclasses.replace(Link("openc3", address, "DEFAULT", "TRK"), **changed).open()) as archive:
        return archive.export(PROFILE, count_us(at(start)), count_us(at(stop)))


def test_packets_stand_apart_in_the_order_of_time_and_a_range_holds_its_start_and_not_its_stop(address):
    rows = export(address, 0, 2)
    assert rows.times_us.tolist() == [count_us(at(second)) for second in (0, 0.5, 1, 1.5)]
    names = rows.header.split(",")
    cells = [dict(zip(names, line.split(","), strict=True)) for line in rows.lines]
    assert [cell["TRK STARS STAR1_ROW"] for cell in cells] == ["10.5", "", "11.5", ""]
    assert [cell["TRK ATTITUDE Q_W"] for cell in cells] == ["", "1.0", "", "1.0"]
    assert not any(name.endswith("STAR3_ROW") for name in names)
    assert export(address, 0, 0.5).lines == rows.lines[:1]  # one row comes without its outer list
    assert export(address, 100, 101).lines == []


def test_what_is_pulled_is_telemetry(address, tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_OPENC3_URL", address)
    (tmp_path / "tracker.json").write_text(json.dumps(profile_document()))
    asked = ["--start", at(-1).isoformat(), "--stop", at(100).isoformat(), "--profile", str(tmp_path / "tracker.json")]
    done = CliRunner().invoke(main, ["openc3", "pull", *asked, "--out", str(tmp_path / "pass.csv")])
    assert done.exit_code == 0, done.output
    pulled = read_telemetry(tmp_path / "pass.csv")
    assert pulled.row_px.tolist() == [value for k in range(5) for value in (10.5 + k, 30.0 + k)]
    assert pulled.quaternion[0].tolist() == [0, 0, 0, 1]  # between two packets


def test_a_password_lets_us_in_and_a_name_is_refused(openc3, address, tmp_path):
    openc3.password = "secret"
    file = tmp_path / "credentials"
    for text, error in (("secret", None), ("wrong", UnavailableError), ("olga:secret", RefusedInputError)):
        file.write_text(text)
        if error is None:
            assert len(export(address, 0, 2, credentials=str(file)).lines) == 4
        else:
            with pytest.raises(error):
                export(address, 0, 2, credentials=str(file))
    with pytest.raises(UnavailableError):
        export(address, 0, 2)


def test_items_that_are_not_there_are_refused_unless_the_profile_can_do_without(openc3, address):
    del openc3.packets["TRK", "ATTITUDE"]
    assert len(export(address, 0, 2).lines) == 2
    del openc3.packets["TRK", "STARS"]
    with pytest.raises(RefusedInputError, match="STAR1_ROW"):
        export(address, 0, 2)


def test_openc3_s_own_client_asks_the_same_of_the_same_server(address):
    """Runs where the package `openc3` is installed; only its JSON-RPC object is used."""
    pytest.importorskip("openc3.io.json_drb_object")
    drb = sys.modules["openc3.io.json_drb_object"].JsonDRbObject(address, timeout=5.0)
    items = drb.get_tlm_available(["TRK__STARS__STAR1_ROW__CONVERTED", "TRK__STARS__NOPE__CONVERTED"], scope="DEFAULT")
    assert [item is None for item in items] == [False, True]
    asked = ["TRK__STARS__PACKET_TIMEFORMATTED__RAW", items[0]]
    rows = drb.get_tlm_values(asked, start_time=at(0).isoformat(), end_time=at(2).isoformat(), scope="DEFAULT")
    ours = export(address, 0, 2)
    place = ours.header.split(",").index("TRK STARS STAR1_ROW")
    found = [line.split(",") for line in ours.lines[::2]]
    assert [(row[0][0], row[1][0]) for row in rows] == [(cells[0], float(cells[place])) for cells in found]
    drb.shutdown()
