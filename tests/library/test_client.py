"""`boresight.Client` and `AsyncClient` against a real server: what a person's program asks, and what it is refused."""

import asyncio
import time

import plotly.graph_objects as go
import pytest

import boresight as bs
from boresight.library import client as client_module
from boresight.library import remote
from boresight.platform.web.problems import KINDS
from tests.choices import made_choice
from tests.library.conftest import key_of
from tests.library.servers import answering
from tests.refusals import has_code
from tests.served import PASSWORD


@pytest.fixture
def client(house, key):
    with bs.Client(house.address, key) as opened:
        yield opened


@pytest.mark.parametrize(("url", "key"), [(None, "k"), (3, "k"), ("https://boresight.example", 3)])
def test_a_client_is_of_an_address_and_a_key_in_words(url, key):
    for kind in (bs.Client, bs.AsyncClient):
        with pytest.raises(bs.RefusedInputError):
            kind(url, key)


def test_a_closed_client_says_that_it_is():
    client, later = (kind("https://boresight.example") for kind in (bs.Client, bs.AsyncClient))
    client.close()
    with pytest.raises(bs.RefusedInputError, match="closed"):
        client.sensors()

    async def ask():
        await later.close()
        await later.sensors()

    with pytest.raises(bs.RefusedInputError, match="closed"):
        asyncio.run(ask())


@pytest.mark.usefixtures("computing")
def test_telemetry_becomes_a_calibration_in_one_call(client, house, tmp_path):
    (tmp_path / "telemetry.csv").write_bytes(house.telemetry_csv)
    told = []
    cal = client.calibrate(
        tmp_path / "telemetry.csv",
        sensor=house.sensor_file(),
        progress=lambda message, _: told.append(message),
        free="f_m",
    )
    assert isinstance(cal, bs.Calibration)
    assert cal.to_dict() == house.result
    assert told[0] == "uploading the telemetry"


@pytest.mark.usefixtures("computing")
def test_each_step_is_a_call_with_a_typed_answer(client, house):
    sensor = client.sensor(house.sensor_file())
    assert client.sensor(sensor.name) == client.sensor(sensor.id) == sensor
    assert sensor.id in {one.id for one in client.sensors()}
    stars = client.upload(bs.simulate({"sensor": 1, "frames": 6}).telemetry, sensor)
    assert (stars.sensor_id, stars.frames, stars.purpose) == (sensor.id, 6, "calibration")
    run = client.launch(stars, label="by hand", method="sqrf", variant="q")
    assert (run.method, run.settings["variant"], run.label) == ("sqrf", "q", "by hand")
    assert client.wait(run).state == "SUCCEEDED"
    assert client.fetch(run).parameters.f_m == house.result["parameters"]["f_m"]
    assert "convergence" in client.figures(run)
    assert isinstance(client.figure(run, "convergence"), go.Figure)
    assert "</html>" in client.report(run)


@pytest.mark.usefixtures("computing")
def test_a_camera_is_chosen_for_a_run_or_for_telemetry(client, house, tmp_path):
    run = house.finished()
    with pytest.raises(bs.NotFoundError):
        client.choice(run)
    chosen = client.choose(run)
    assert isinstance(chosen, bs.Choice)
    assert client.choice(run) == chosen == client.choose(client.run(run)) == bs.Choice(**vars(made_choice()))
    (tmp_path / "telemetry.csv").write_bytes(house.telemetry_csv)
    assert client.choose(tmp_path / "telemetry.csv", house.sensor_file(), match="given") == chosen
    with pytest.raises(bs.RefusedInputError, check=has_code("run-alone")):
        client.choose(run, match="given")

    async def choose():
        async with bs.AsyncClient(house.address, client._key) as other:
            return await other.choose(run), await other.choice(run)

    assert asyncio.run(choose()) == (chosen, chosen)


@pytest.mark.full
def test_a_set_is_diagnosed_with_or_without_async_and_keeps_the_answer(client, house, exchanged):
    sensor = client.sensor(house.sensor_file())
    found = client.diagnose(exchanged, sensor)
    assert isinstance(found, bs.Diagnosis)
    assert found.names == ("swapped_axes",)
    stored = client.upload(exchanged, sensor)
    assert stored.quality["diagnosis"] == found.to_dict()
    with pytest.raises(bs.RefusedInputError):
        client.diagnose(stored, sensor)
    with pytest.raises(bs.RefusedInputError):
        client.diagnose(exchanged)

    async def diagnose():
        async with bs.AsyncClient(house.address, client._key) as other:
            return await other.diagnose(stored.id)

    assert asyncio.run(diagnose()) == found


def test_a_result_goes_to_approval_and_is_exported_once_people_signed(client, house):
    run = house.finished()
    candidate = client.make_parameter_set(run)
    assert client.make_parameter_set(run) == candidate
    report = client.assess(candidate)
    assert report.verdict in {"PASS", "MARGINAL", "NO-DATA", "FAIL"}
    assert {gate.status for gate in report.gates} <= {"PASS", "MARGINAL", "NO-DATA", "FAIL"}
    approval = client.submit(client.parameter_set(candidate.id), "It moved.")
    assert approval.state == "OPEN"
    with pytest.raises(bs.ConflictError):
        client.export(candidate)
    assert house.sign("alan", vars(approval)).status_code == 200
    assert client.approval(approval).state == "APPROVED"
    assert client.export(candidate).startswith(b"PK")


def test_a_request_is_taken_back(client, house):
    candidate = client.make_parameter_set(house.finished())
    client.submit(candidate, "Too early.")
    assert client.withdraw(candidate, "Too early indeed.").ground_state == "WITHDRAWN"


def test_a_key_does_not_sign(house):
    approval = house.submitted()
    signed = {"meaning": "Yes.", "password": PASSWORD}
    headers = {"Authorization": f"Bearer {key_of(house, 'alan')}", "If-Match": f'"v{approval["version"]}"'}
    answer = house.anybody(**headers).post(f"/api/v1/approvals/{approval['id']}:approve", json=signed)
    assert answer.status_code == 403
    assert not [name for name in dir(bs.Client) if name in {"approve", "refuse", "sign"}]


def test_a_run_that_is_stopped_or_fails_is_an_exception_with_the_reason(client, house):
    run = client.run(house.launched()["id"])
    client.cancel(run, "wrong set")
    with pytest.raises(bs.CancelledError, match=str(run.id)):
        client.wait(run)
    failed = house.launched()["id"]
    house.end(failed, "FAILED")
    with pytest.raises(bs.RunFailedError, match=str(failed)):
        client.wait(failed)


def test_waiting_has_an_end_where_it_is_given_one(client, house):
    began = time.perf_counter()
    with pytest.raises(bs.UnavailableError, match="QUEUED"):
        client.wait(house.launched()["id"], timeout_s=0.2)
    assert time.perf_counter() - began < 5


@pytest.mark.parametrize(
    ("ask", "error"),
    [
        (lambda client: client.run(10**6), bs.NotFoundError),
        (lambda client: client.sensor("no such sensor"), bs.NotFoundError),
        (lambda client: client.launch(10**6), bs.NotFoundError),
        (lambda client: client.upload("nowhere.csv", 1), bs.RefusedInputError),
        (lambda client: client.sensor("s" * 5000), bs.NotFoundError),
        (lambda client: client.upload("t" * 5000, 1), bs.RefusedInputError),
    ],
    ids=["run", "sensor", "set", "file", "long sensor", "long file"],
)
def test_a_refusal_is_one_sentence(client, ask, error):
    with pytest.raises(error) as refused:
        ask(client)
    assert "\n" not in str(refused.value)


def test_a_refused_file_names_row_and_column(client, house, tmp_path):
    lines = house.telemetry_csv.decode().splitlines()
    lines[3] = lines[3].replace(lines[3].split(",")[2], "odd", 1)
    (tmp_path / "odd.csv").write_text("\n".join(lines))
    with pytest.raises(bs.RefusedInputError) as refused:
        client.upload(tmp_path / "odd.csv", house.sensor_file())
    assert refused.value.faults[0].row == 4


def test_another_description_under_a_name_that_is_there_is_refused(client, house):
    document = house.sensor_file()
    client.sensor(document)
    with pytest.raises(bs.ConflictError, match=document["name"]):
        client.sensor(document | {"centroid_sigma_px": 9.0})


def test_without_a_key_nothing_is_told_and_a_key_is_never_shown(house):
    with bs.Client(house.address) as nobody, pytest.raises(bs.UnauthenticatedError):
        nobody.sensors()
    assert "secret" not in repr(bs.Client(house.address, "secret"))
    with pytest.raises(bs.RefusedInputError):
        bs.Client("boresight.example")


@pytest.mark.usefixtures("computing")
def test_the_same_with_async(house, key):
    async def ask():
        async with bs.AsyncClient(house.address, key) as client:
            sensor = await client.sensor(house.sensor_file())
            telemetry = bs.simulate({"sensor": 1, "frames": 6}).telemetry
            cals = await asyncio.gather(*(client.calibrate(telemetry, sensor, label=str(n)) for n in range(3)))
            with pytest.raises(bs.NotFoundError):
                await client.run(10**6)
            return cals

    assert [cal.to_dict() for cal in asyncio.run(ask())] == 3 * [house.result]


def test_both_clients_have_the_same_methods():
    public = [{name for name in dir(kind) if name[0] != "_"} for kind in (bs.Client, bs.AsyncClient)]
    assert public[0] == public[1]


def test_every_problem_of_the_server_has_its_exception():
    for error, kind in KINDS.items():
        assert issubclass(error, remote.PROBLEMS[kind.address.removeprefix(remote.PROBLEM)])


def test_a_request_that_failed_is_sent_again_under_its_key(monkeypatch):
    monkeypatch.setattr(client_module, "FIRST_PAUSE_S", 0.01)
    counts = dict.fromkeys(("id", "sensor_id", "frames", "stars"), 3)
    set_of = counts | {"name": "a", "purpose": "calibration", "original_sha256": "", "quality": {}}
    sensor = {"id": 1, "name": "ST", "version": 1, "document": {}}
    with (
        answering([(200, sensor), None, (503, {}), (201, set_of)]) as (address, seen),
        bs.Client(address, "k") as client,
    ):
        assert client.upload({"frame": [1], "exposure": [0], "row_px": [1.0], "col_px": [2.0]}, 1).id == 3
    keys = [one.get("Idempotency-Key") for one in seen]
    assert len(keys) == 4
    assert keys[0] is None
    assert len({*keys[1:]}) == 1
    assert keys[1] is not None


def test_a_server_that_stays_silent_is_said_to_be(monkeypatch):
    monkeypatch.setattr(client_module, "FIRST_PAUSE_S", 0.01)
    with answering([None] * 5) as (address, seen), bs.Client(address, "k") as client:
        with pytest.raises(bs.UnavailableError, match=address):
            client.sensors()
        assert len(seen) == 5
    turned_away = pytest.raises(bs.UnavailableError, match="502")
    with answering([(502, {})] * 5) as (address, _), bs.Client(address, "k") as client, turned_away:
        client.sensors()
