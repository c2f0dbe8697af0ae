"""Uplink packages out of the store: for whom, of what, and the same bytes again."""

import io
import json
import zipfile

import pytest

from boresight.console.approvals import service as approvals
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import packages, table_definitions
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError, StaleError
from boresight.platform.actors import POLICY, Policy
from boresight.platform.audit import log as audit
from boresight.platform.audit.signing import SigningKey
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.uplink.verify_package import verify
from tests.console.conftest import PASSWORD, SENSOR
from tests.passwords import approve, proved
from tests.refusals import has_code

DEFINITION = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "length_bytes": 72,
    "fields": [
        {"name": f"F{place}", "parameter": name, "offset_bytes": 8 * place, "type": "float64"}
        for place, name in enumerate(SENSOR["initial"])
    ],
    "crc": {"name": "CRC-32", "offset_bytes": 64},
}


def _unpacked(content):
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


@pytest.fixture
def build(engine, people, blobs):
    def act(row, who="dee", key=None, policy=POLICY, **said):
        with open_reading(engine) as session:
            prepared = packages.prepare(session, people[who], blobs, row.id, policy=policy, key=key)
        with open_writing(engine) as session:
            package = packages.build(session, people[who], blobs, row.id, prepared, policy=policy, **said)
            return package, _unpacked(packages.read(session, blobs, package.id))

    return act


@pytest.fixture
def define(engine, people):
    def act(document=DEFINITION, seen=0, who="ana", reason="first table"):
        with open_writing(engine) as session:
            return table_definitions.set_definition(session, people[who], 1, document, reason, seen)

    return act


def test_built_again_it_is_the_package_that_exists_and_bytes_that_were_lost_are_laid_down_again(
    engine, blobs, build, approved, define
):
    define()
    row = approved()
    with open_writing(engine) as session:
        head = audit.head(session)
    package, files = build(row)
    again = build(row, "ana")[0]
    assert (again.id, again.sha256) == (package.id, package.sha256)
    assert json.loads(files["MANIFEST.json"])["audit"]["head"] == head  # of its first building
    with open_writing(engine) as session:
        content, record = (
            packages.read(session, blobs, package.id),
            audit.find_last_change(session, f"packages/{package.id}"),
        )
    assert packages.rebuild(json.loads(json.dumps(package.inputs))) == content
    assert (record.action, record.after["sha256"]) == ("exported", package.sha256)
    blobs.path(package.sha256).unlink()
    assert build(row)[1] == files


def test_an_exported_package_is_signed_once_verifies_on_board_and_is_built_again_without_the_key(
    engine, blobs, build, approved, tmp_path
):
    key, row = SigningKey(tmp_path / "signing.key"), approved()
    unsigned = build(row)[0]
    package = build(row, key=key)[0]
    assert (package.id != unsigned.id, package.signature["key"]) == (True, key.load().public.id)
    keys = key.list_public_keys()[0].pem.encode()
    assert verify(blobs.path(package.sha256), keys) == package.signature["key"]
    with pytest.raises(ValueError, match="not signed"):
        verify(blobs.path(unsigned.sha256), keys)
    key.rotate()
    assert build(row, key=key)[0].id == package.id
    blobs.path(package.sha256).unlink()
    key.file.unlink()
    assert build(row)[0].id == package.id  # what was signed is laid down again
    with open_writing(engine) as session:
        assert audit.find_last_change(session, f"packages/{package.id}").after["signed_by"] == package.signature["key"]
        assert audit.verify(session, blobs=blobs).ok


def test_nothing_is_computed_in_the_transaction_that_stores_and_what_changed_meanwhile_is_not_stored(
    engine, people, blobs, define, monkeypatch
):
    def make():
        with open_reading(engine) as session:
            return packages.prepare(session, people["dee"], blobs, 1)

    def store(prepared):
        with open_writing(engine) as session:
            return packages.build(session, people["dee"], blobs, 1, prepared)

    early = make()
    define()
    late = make()
    monkeypatch.setattr(packages, "make_files", None)
    monkeypatch.setattr(packages, "build_package", None)
    with pytest.raises(StaleError, check=has_code("changed-while-built")):
        store(early)
    assert store(late).inputs == late.inputs


def test_the_way_back_of_an_approved_set_is_the_baseline_and_of_the_baseline_the_one_before(
    engine, people, build, approved
):
    def way_back():
        row = approved()
        yield json.loads(build(row)[1]["MANIFEST.json"])["backout"]
        with open_writing(engine) as session:
            row = approvals.promote(session, people["dee"], row.id, row.version)
        yield json.loads(build(row)[1]["MANIFEST.json"])["backout"]

    (first, _), (second, last) = way_back(), way_back()
    assert [way["name"] for way in (first, second, last)] == ["PS-ST16-1-0", "PS-ST16-1-1", "PS-ST16-1-1"]
    assert "the current baseline" in first["sentence"]
    assert "the baseline before" in last["sentence"]


def test_the_first_baseline_is_its_own_way_back(engine, build):
    with open_writing(engine) as session:
        row = session.get_known(ParameterSet, 1)
    files = build(row)[1]
    assert files["backout/parameters.json"] == files["parameters.json"]
    assert "nothing earlier" in json.loads(files["MANIFEST.json"])["backout"]["sentence"]


def test_signatures_with_meaning_and_who_gave_the_password_travel_with_it(build, approved):
    files = build(approved())[1]
    signature = json.loads(files["MANIFEST.json"])["approval"]["signatures"][0]
    assert (signature["printed_name"], signature["meaning"]) == ("Cy", "I approve")
    assert signature["password_by"].startswith("given by Command")
    sheet = files["verification_sheet.html"].decode()
    assert "I approve" in sheet
    assert f"Cy<br>Password {signature['password_by']}." in sheet


def test_an_installation_without_four_eyes_says_so(build, approved):
    files = build(approved(), policy=Policy(four_eyes=False))[1]
    assert json.loads(files["MANIFEST.json"])["four_eyes"]["enforced"] is False
    assert b"FOUR-EYES RULE OFF" in files["verification_sheet.html"]


def test_a_candidate_is_not_exported(build, candidate):
    with pytest.raises(ConflictError, match="is CANDIDATE"):
        build(candidate())


@pytest.mark.parametrize("who", ["cy", "eve", "root"])
def test_who_neither_operates_nor_analyses_does_not_export(build, approved, who):
    with pytest.raises(ForbiddenError):
        build(approved(), who)


@pytest.mark.parametrize(("key", "value"), [("flight_software_version", "4.3.0"), ("table_id", "OTHER")])
def test_it_is_refused_for_another_version_or_table(build, approved, define, key, value):
    define()
    row = approved()
    build(row, flight_software_version="4.2.1", table_id="STR_CAM")
    with pytest.raises(ConflictError, match=f"not for {key.replace('_', ' ')} {value}"):
        build(row, **{key: value})


def test_without_a_definition_there_is_no_table_and_no_version(build, approved):
    row = approved()
    _, files = build(row)
    assert not [name for name in files if name.startswith("table")]
    with pytest.raises(ConflictError, check=has_code("no-table-definition")):
        build(row, flight_software_version="4.2.1")


def test_another_definition_makes_the_request_stale(engine, define, approved):
    row = approved()
    define()
    with open_writing(engine) as session:
        assert session.get_known(ParameterSet, row.id).ground_state == "CANDIDATE"


def test_a_definition_needs_what_was_seen_a_reason_and_a_change(define):
    define()
    with pytest.raises(RefusedInputError, check=has_code("already-in-force")):
        define(seen=1)
    with pytest.raises(RefusedInputError, check=has_code("reason-missing")):
        define(DEFINITION | {"fill": 255}, seen=1, reason=" ")
    assert define(DEFINITION | {"fill": 255}, seen=1).number == 2


def test_there_is_no_package_of_an_unknown_number(engine, blobs):
    with open_writing(engine) as session, pytest.raises(NotFoundError):
        packages.read(session, blobs, 99)


def test_the_turn_of_the_attitude_travels_where_the_run_began_at_the_set_replaced(
    engine, people, blobs, build, finished_run
):
    found = {
        "quaternion": [0.0, 0.0, 0.0, 1.0], "rotation_arcsec": [4.1, 0.0, 0.0], "sigma_arcsec": [1.0, 1.0, 9.0],
        "sigma_of_mean_arcsec": [0.1, 0.1, 0.9], "frames": 40, "scatter_arcsec": 1.0, "noise_arcsec": 1.1, "consistent": True,
        "sentence": "Loading these parameters turns the attitude.", "c_sd_update": [[1.0]],
    }  # fmt: skip
    with open_writing(engine) as session:
        run = finished_run(session, people["ana"].user_id, alignment=found)
        row = parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
        request = approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
        approve(session, people["cy"], request)
    files = build(row)[1]
    assert json.loads(files["c_sd.json"])["alignment"] == found
    assert json.loads(files["parameters.json"])["provenance"]["run"]["launched_by"] == "Ana"


def test_what_was_signed_with_fewer_eyes_is_said_for_ever(engine, people, build, candidate, blobs):
    alone = Policy(four_eyes=False)
    row = candidate("bo")
    with open_writing(engine) as session:
        request = approvals.submit(session, people["bo"], blobs, row.id, "better", row.version, policy=alone)
        decided = approvals.Decision("APPROVE", "I approve")
        words = (request.id, decided, proved(session, people["bo"], PASSWORD), request.version)
        approvals.sign(session, people["bo"], *words, policy=alone)
    four_eyes = json.loads(build(row)[1]["MANIFEST.json"])["four_eyes"]
    assert (four_eyes["enforced"], four_eyes["kept"]) == (True, False)
    assert four_eyes["sentence"].startswith("FOUR-EYES RULE NOT FOLLOWED")


def test_an_approved_set_whose_evidence_moved_is_not_exported(engine, people, build, approved, candidate):
    row, other = approved(), candidate()
    with open_writing(engine) as session:  # as if the incumbent had been exchanged past the services
        for number, state in ((1, "SUPERSEDED"), (other.id, "BASELINE")):
            session.get_one(ParameterSet, number).ground_state = state
            audit.append(session, people["root"], "exchanged", f"parameter-sets/{number}")
    with pytest.raises(StaleError, match="baseline changed"):
        build(row)
