"""`--server URL`: the commands on a server, as the key in the environment may."""

import json

import click
import pytest
from click.testing import CliRunner

import boresight as bs
from boresight.cli import main
from boresight.cli.remote import API_KEY
from tests.choices import made_choice


@pytest.fixture
def files(house, tmp_path):
    (tmp_path / "telemetry.csv").write_bytes(house.telemetry_csv)
    (tmp_path / "sensor.json").write_text(json.dumps(house.sensor_file()))
    return tmp_path


@pytest.fixture
def run(house, key, monkeypatch):
    monkeypatch.setenv(API_KEY, key)
    return lambda *words: CliRunner().invoke(
        main, [*map(str, words), "--server", house.address], catch_exceptions=False
    )


@pytest.mark.usefixtures("computing")
def test_a_calibration_on_a_server_prints_and_writes_what_it_would_here(run, files, house):
    out = files / "out.json"
    done = run("calibrate", files / "telemetry.csv", "--sensor", files / "sensor.json", "--free", "f_m", "--json", out)
    assert done.exit_code == 0, done.stderr
    assert json.loads(out.read_text()) == house.result
    assert done.stdout == repr(bs.load(house.result)) + "\n"
    name = json.loads((files / "sensor.json").read_text())["name"]
    assert run("calibrate", files / "telemetry.csv", "--sensor", name).exit_code == 0


@pytest.mark.usefixtures("computing")
def test_a_camera_is_chosen_on_a_server(run, files):
    out, sensor = files / "choice.json", files / "chosen.json"
    words = ("choose", files / "telemetry.csv", "--sensor", files / "sensor.json", "--json", out, "--out", sensor)
    done = run(*words)
    assert done.exit_code == 0, done.stderr
    assert json.loads(out.read_text()) == made_choice().to_dict()
    assert made_choice().sentence in done.stdout
    assert bs.read_sensor(sensor).free == tuple(made_choice().chosen.free)


@pytest.mark.full
def test_a_set_is_diagnosed_on_a_server_and_the_files_are_mended_here(run, files, exchanged):
    out, right, told = files / "mended.json", files / "right.csv", files / "diagnosis.json"
    exchanged.replace(files / "telemetry.csv")
    words = ("diagnose", files / "telemetry.csv", "--sensor", files / "sensor.json")
    done = run(*words, "--json", told, "--out", out, "--out-telemetry", right)
    assert done.exit_code == 0, done.stderr
    document = json.loads(told.read_text())
    assert document["causes"][0]["name"] == "swapped_axes"
    assert document["sentence"] in done.stdout
    again = run("diagnose", right, "--sensor", bs.read_sensor(out).name, "--json", "-")
    assert json.loads(again.stdout)["causes"][0]["name"] == "none"


def test_what_to_observe_next_is_planned_on_a_server(run, files, house):
    finished = house.converged()
    sensor = house.person("ada").get(f"/api/v1/runs/{finished}").json()["sensor_id"]
    name = house.person("ada").get(f"/api/v1/sensors/{sensor}").json()["name"]
    (files / "few.csv").write_text("ra_deg,dec_deg,roll_deg\n10,5,0\n200,60,90\n120,-40,30\n")
    words = ("plan", "--sensor", name, "--start", "2026-10-01T00:00:00Z", "--minutes", "4", "--calibration", finished)
    words += ("--candidates", files / "few.csv", "--sun-deg", 0, "--moon-deg", 0, "--out", files / "plan.csv")
    done = run(*words, "--json", files / "plan.json")
    assert done.exit_code == 0, done.stderr
    document = json.loads((files / "plan.json").read_text())
    assert document["sentence"] in done.stdout
    assert len((files / "plan.csv").read_text().splitlines()) == 1 + len(document["pointings"])


def test_a_report_and_a_package_come_from_the_server(run, files, house):
    done = run("report", house.finished(), "--out", files / "run.html")
    assert done.exit_code == 0, done.stderr
    assert "</html>" in (files / "run.html").read_text()
    approved = house.approved()
    for name, file in ((approved["name"], "a.zip"), (approved["id"], "b.zip")):
        done = run("export", name, "--out", files / file)
        assert done.exit_code == 0, done.stderr
    assert (files / "a.zip").read_bytes() == (files / "b.zip").read_bytes()


def test_a_set_is_assessed_and_submitted_on_a_server_as_here(run, files, house):
    candidate, told = house.candidate(), files / "gates.json"
    done = run("assess", candidate["name"], "--json", told)
    assert done.exit_code == 0, done.stderr
    on_server, here = json.loads(told.read_text()), bs.assess(house.result, house.sensor_file(), progress=False)
    assert on_server.keys() == here.to_dict().keys()
    assert [gate["name"] for gate in on_server["gates"]] == [gate.name for gate in here.gates]
    assert candidate["name"].startswith(f"PS-{on_server['sensor']}-")
    assert done.stdout.startswith("gate ")
    assert on_server["words"] in done.stdout.splitlines()[-1]
    for words in (
        ("assess", candidate["id"], "--sensor", files / "sensor.json"),
        ("submit", "--reason", "None named."),
    ):
        assert (run(*words).exit_code, run(*words).stderr.count("\n")) == (1, 1)
    asked = files / "request.json"
    done = run("submit", candidate["name"], "--reason", "It moved.", "--json", asked)
    assert done.exit_code == 0, done.stderr
    request = json.loads(asked.read_text())
    assert (request["parameter_set_id"], request["state"], request["reason"]) == (candidate["id"], "OPEN", "It moved.")
    assert f"request {request['id']} is OPEN" in done.stdout
    made = run("submit", "--run", house.finished(), "--reason", "It moved again.", "--json", "-")
    assert json.loads(made.stdout)["parameter_set_id"] != candidate["id"]


def test_without_a_key_and_with_a_wrong_one_it_is_refused_in_one_line(run, files, monkeypatch):
    words = ("calibrate", files / "telemetry.csv", "--sensor", files / "sensor.json")
    monkeypatch.setenv(API_KEY, "wrong")
    wrong = run(*words)
    monkeypatch.delenv(API_KEY)
    absent = run(*words)
    assert (wrong.exit_code, absent.exit_code) == (1, 1)
    assert wrong.stderr.count("\n") == absent.stderr.count("\n") == 1
    assert API_KEY in absent.stderr


def commands_of(command):
    below = command.commands.values() if isinstance(command, click.Group) else ()
    return [command, *(found for one in below for found in commands_of(one))]


def test_the_key_is_on_no_command_line():
    options = [one for command in commands_of(main) for one in command.params if isinstance(one, click.Option)]
    named = [option for option in options if "key" in f"{option.opts}"]
    assert all(isinstance(option.type, click.Path) for option in named), named
