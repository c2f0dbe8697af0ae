"""Joint runs and runs with a prior on a real server with a worker: what the library finds here, to the last bit."""

import json

import pytest
from click.testing import CliRunner

import boresight as bs
from boresight.calibration.calibrate import calibrate
from boresight.calibration.joint.passes import NamedTelemetry, join_sets
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import StoredTable
from boresight.cli import main
from boresight.cli.remote import API_KEY
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.blobs.working_tables import working_table
from boresight.platform.db.sessions import open_reading
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv
from tests.calibration.sets import differences, st16_sensor
from tests.calibration.test_joint import a_pass
from tests.refusals import has_code
from tests.served import House, add_people, serving, settings_in

CHOSEN = {"match": "given"}
PATIENCE_S = 240.0


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    for number in range(4):
        write_csv(a_pass(50 + number, day=10.0 * number, frames=40), folder / f"pass-{number}.csv")
    (folder / "sensor.json").write_text(json.dumps(sensor_document(st16_sensor(1))))
    return folder


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joint")
    settings = settings_in(folder, workers="1", login_attempts="1000")
    add_people(settings)
    with serving(settings, load_catalogue(folder / "catalogue")) as (address, app):
        made = House(address, app, b"", {})
        yield made
        for client in made.opened:
            client.close()


@pytest.fixture(scope="module")
def server(house):
    answer = house.person("ada").post(
        "/api/v1/api-keys", json={"label": "joint", "scopes": ["sensors", "telemetry-sets", "runs"]}
    )
    with bs.Client(house.address, answer.json()["secret"]) as client:
        client.api_key = answer.json()["secret"]
        yield client


@pytest.fixture(scope="module")
def sets(server, files):
    return [server.upload(files / f"pass-{number}.csv", files / "sensor.json") for number in range(4)]


def found(server, *given, **chosen):
    run = server.wait(server.launch(*given, **CHOSEN, **chosen), timeout_s=PATIENCE_S)
    return run, server.fetch(run)


def unlike(one, other):
    """Where two calibrations differ, but for what they call files that only one of them had."""
    documents = [each.to_dict() for each in (one, other)]
    for document in documents:
        document["inputs"]["sha256s"].pop("sensor", None)
        document["inputs"]["sha256s"].pop("prior", None)
        (document.get("prior") or {}).pop("sha256", None)
    return differences(*documents)


@pytest.fixture(scope="module")
def joint(server, sets):
    return found(server, sets[:2])


@pytest.mark.few(1)
@pytest.mark.parametrize("vary", [{}, {"vary": ["f_m"], "vary_as": "walk"}], ids=["alike", "walk"])
def test_several_sets_are_calibrated_on_a_worker_as_they_are_here(server, sets, files, vary):
    run, there = found(server, sets[:3], **vary)
    here = bs.calibrate(
        [files / f"pass-{number}.csv" for number in range(3)], files / "sensor.json", progress=False, **CHOSEN, **vary
    )
    assert unlike(there, here) == []
    assert [one.sha256 for one in there.inputs.passes] == [one.original_sha256 for one in sets[:3]]
    assert (run.telemetry_set_id, run.joint_set_ids) == (sets[0].id, [sets[1].id, sets[2].id])


@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_a_run_starts_from_another_with_its_covariance_and_its_age(server, sets, joint, files, tmp_path, method):
    before, known = joint
    drift = {"prior_drift_sigma": 0.02}
    run, there = found(server, sets[3], prior=before, method=method, **drift)
    known.save(tmp_path / f"run {before.id}")
    here = bs.calibrate(
        files / "pass-3.csv", files / "sensor.json", prior=tmp_path / f"run {before.id}", method=method, progress=False,
        **CHOSEN, **drift,
    )  # fmt: skip
    assert unlike(there, here) == []
    assert (run.prior_run_id, run.prior_set_id) == (before.id, None)
    assert there.prior.age_days == pytest.approx(20.0, abs=0.001)
    assert there.prior.telemetry_sha256s == sorted(one.original_sha256 for one in sets[:2])
    assert set(there.prior.share) == set(there.free)
    assert there.prior.agreement.p_value > 0.001


def test_what_a_prior_holds_counts_once_however_many_runs_ago_it_was_taken_in(server, house, sets, joint):
    second, _ = found(server, sets[2], prior=joint[0])
    _, third = found(server, [sets[0], sets[2], sets[3]], prior=second)
    assert [one.sha256 for one in third.inputs.passes] == [sets[3].original_sha256]
    assert third.prior.telemetry_sha256s == sorted(one.original_sha256 for one in sets[:3])
    with pytest.raises(bs.RefusedInputError, check=has_code("prior-holds-telemetry")):
        server.launch(sets[0], prior=second)
    order = {"sensor_id": sets[0].sensor_id, "telemetry_set_id": sets[0].id, "joint_set_ids": [sets[3].id]}
    said = (
        house.person("ada").post("/api/v1/runs", json=order | {"prior_run_id": second.id, "validate_only": True}).json()
    )
    assert (said["left_out"], said["joint_sets"], said["prior"]) == (["pass-0.csv"], ["pass-3.csv"], f"run {second.id}")
    assert said["frames"] == 40


def test_stored_tables_in_pieces_give_the_bits_of_those_in_memory(house, sets, catalogue):
    with open_reading(house.app.state.engine) as session:
        rows = [session.get_one(TelemetrySet, one.id) for one in sets[:2]]
    tables = [
        NamedTelemetry(
            StoredTable(*working_table(house.app.state.blobs, row.table_sha256)), row.name, row.original_sha256
        )
        for row in rows
    ]
    settings = CalibrationSettings(**CHOSEN)
    whole, pieces = (
        calibrate(join_sets(tables, large_rows), st16_sensor(1), catalogue, settings) for large_rows in (10**9, 0)
    )
    assert differences(whole.to_dict(), pieces.to_dict()) == []


def test_the_command_sends_several_sets_and_a_prior(house, server, sets, files, joint, monkeypatch, tmp_path):  # noqa: ARG001 - the sets are there then
    monkeypatch.setenv(API_KEY, server.api_key)
    words = ["calibrate", *(str(files / f"pass-{n}.csv") for n in (2, 3)), "--sensor", str(files / "sensor.json")]
    words += [
        "--match",
        "given",
        "--prior",
        str(joint[0].id),
        "--server",
        house.address,
        "--json",
        str(tmp_path / "out.json"),
    ]
    done = CliRunner().invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["prior"]["name"] == f"run {joint[0].id}"
    assert len(document["inputs"]["passes"]) == 2
    by_file = [str(files / "sensor.json") if word == str(joint[0].id) else word for word in words]
    assert CliRunner().invoke(main, by_file).exit_code == 1


def test_a_run_s_page_says_what_came_from_its_prior_and_what_each_pass_says(server, house, sets, joint):
    run, there = found(server, sets[2:4], prior=joint[0])
    page = house.person("ada").get(f"/runs/{run.id}").text
    prior = page[page.index('id="prior"') : page.index('id="passes"')]
    for name in there.free:
        assert f'value="{round(there.prior.share[name], 4)}" aria-label="{name} from the prior"' in prior
    assert f"{there.prior.agreement.p_value:.2g}" in prior
    passes = page[page.index('id="passes"') : page.index('id="minima"')]
    assert [f'href="/telemetry/{one.id}"' in passes for one in sets] == [False, False, True, True]
    assert "figure-passes" not in page
    record = house.person("ada").get(f"/runs/{run.id}?part=record").text
    assert "boresight calibrate pass-2.csv pass-3.csv" in record
    assert f"--prior run-{joint[0].id}.json" in record
    assert f'href="/runs/{joint[0].id}"' in record


def test_what_varies_is_drawn_over_the_passes_and_read_as_a_table(server, house, sets):
    run, there = found(server, sets[:3], vary=["f_m"], vary_as="walk")
    ada = house.person("ada")
    page = ada.get(f"/runs/{run.id}").text
    assert "figure-passes" in page
    drawn = ada.get(f"/api/v1/runs/{run.id}/passes/figure").json()["data"]
    assert [len(trace["x"]) for trace in drawn] == [3]
    lines = ada.get(f"/api/v1/runs/{run.id}/passes/data").text.splitlines()
    assert lines[0] == "pass,start_utc,frames,stars,pairs,chi2,temperature_c,f_m,sigma_f_m"
    assert [float(line.split(",")[-1]) for line in lines[1:]] == [
        state.sigma["f_m"] for state in there.variation.states
    ]


def test_a_clone_keeps_the_sets_and_the_prior(server, house, sets, joint):
    run, _ = found(server, sets[2:4], prior=joint[0])
    page = house.person("ada").get(f"/runs/new?clone={run.id}").text
    ticked = page[page.index("data-further") : page.index('id="prior"')]
    assert [f'value="{one.id}" checked' in ticked for one in sets] == [False, False, False, True]
    assert f'<option value="run-{joint[0].id}" data-sensor="{run.sensor_id}" selected>' in page


def test_the_frames_of_a_joint_run_are_those_of_all_its_sets_as_its_result_numbers_them(house, joint):
    victor, run = house.person("victor"), joint[0]
    listed = victor.get(f"/api/v1/runs/{run.id}/frames", params={"limit": 200}).json()["items"]
    assert [line["frame"] for line in listed] == list(range(80))
    seen = victor.get(f"/api/v1/runs/{run.id}/frames/45").json()
    assert (seen["place"], seen["frames"], seen["previous"], seen["next"]) == (46, 80, 44, 46)
    assert all(star["fate"] == "used" for star in seen["exposures"][0]["stars"])
    at_the_seam = victor.get(f"/api/v1/runs/{run.id}/frames/40").json()
    assert at_the_seam["time_utc"].startswith("2026-01-11")


def test_runs_that_share_sets_are_compared_by_what_they_share(server, house, sets, joint):
    other, _ = found(server, sets[1:3])
    compared = house.person("victor").get("/api/v1/runs/compare", params={"runs": f"{joint[0].id},{other.id}"}).json()
    shared = compared["runs"][1]["shared_data"]
    assert (shared["kind"], shared["share"], shared["share_of_reference"]) == ("partly", 0.5, 0.5)
