"""The baseline's table goes into a mission control system by an operator in person, on record before and after."""

from contextlib import closing

import pytest
from sqlalchemy import select
from yamcs.client import YamcsClient

from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import hand_over
from boresight.errors import ConflictError, ForbiddenError
from boresight.mission_control.systems import Link
from boresight.platform.actors import Actor
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.uplinks.pages import define, table, version
from tests.mission_control.openc3_stand_in import OpenC3StandIn
from tests.mission_control.yamcs_stand_in import BUCKET, INSTANCE, YamcsStandIn, serving

STEPS = "/parameter-sets/1/uplink"


@pytest.fixture
def yamcs():
    return YamcsStandIn()


@pytest.fixture
def address(yamcs):
    with serving(yamcs.app) as found:
        yield found


@pytest.fixture
def olga(site, address):
    """An operator before a baseline that has a package, on a server that is linked."""
    site.app.state.mission_control.links = {"yamcs": Link("yamcs", address, INSTANCE, BUCKET)}
    define(site)
    visitor = site.visitor("olga")
    assert visitor.post(f"{STEPS}/package").status_code == 303
    return visitor


def _records(site, *actions):
    with open_reading(site.engine) as session:
        return session.scalars(
            select(AuditRecord).where(AuditRecord.action.in_(actions)).order_by(AuditRecord.id)
        ).all()


def _send(visitor, site, system="yamcs"):
    return visitor.post(f"{STEPS}/hand-over", system=system, version=version(site))


def test_the_table_lies_in_the_bucket_as_it_was_packed_and_the_log_says_who_put_it_there(site, olga, yamcs, address):
    page = olga.get(STEPS)
    assert 'action="/parameter-sets/1/uplink/hand-over"' in page
    assert _send(olga, site).status_code == 303
    (name,) = yamcs.objects
    with closing(YamcsClient(address)) as client:
        assert client.get_storage_client().download_object(BUCKET, name) == table(site)
    began, ended = _records(site, hand_over.BEGAN, hand_over.ENDED)
    assert (began.actor_id, ended.actor_id) == (site.actor("olga").user_id,) * 2
    assert ended.after["places"] == [f"{BUCKET}/{name}"]
    assert f"{BUCKET}/{name}" in olga.get(STEPS)
    with open_reading(site.engine) as session:
        assert session.get_one(ParameterSet, 1).onboard_state == "NOT SENT"


def test_a_system_that_fails_leaves_the_beginning_on_record_and_the_page_says_why(site, olga, yamcs):
    yamcs.status = 503
    answer = _send(olga, site)
    assert (answer.status_code, "503" in answer.text) == (503, True) or answer.status_code == 200
    assert [one.action for one in _records(site, hand_over.BEGAN, hand_over.ENDED)] == [hand_over.BEGAN]
    assert yamcs.objects == {}


def test_only_an_operator_in_person_hands_over_and_only_to_what_is_set(site, olga, yamcs):
    assert _send(site.visitor("ada"), site).status_code == 403
    assert _send(olga, site, "openc3").status_code == 409
    key = Actor(site.actor("olga").user_id, "olga", "Olga", frozenset({"operator"}), "key:1", frozenset({"uplinks"}))
    with pytest.raises(ForbiddenError), open_writing(site.engine) as session:
        hand_over.begin(session, key, site.blobs, site.app.state.mission_control.links, 1, "yamcs", 1)
    with open_writing(site.engine) as session:
        candidate = parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        with pytest.raises(ConflictError):
            hand_over.begin(session, site.actor("olga"), site.blobs, {}, candidate.id, "yamcs", candidate.version)
    assert yamcs.objects == {}


def test_openc3_gets_image_and_definition_where_table_manager_looks(site, olga):
    openc3 = OpenC3StandIn()
    with serving(openc3.app) as address:
        site.app.state.mission_control.links = {"openc3": Link("openc3", address, "DEFAULT", "TRK")}
        assert _send(olga, site, "openc3").status_code == 303
    places = sorted(openc3.files)
    tables = "DEFAULT/targets_modified/TRK/tables"
    assert [place.rpartition("/")[0] for place in places] == [f"{tables}/bin", f"{tables}/config"]
    assert places[1].removesuffix("_def.txt").rpartition("/")[2] == places[0].removesuffix(".bin").rpartition("/")[2]
    assert openc3.files[places[0]] == table(site)
    assert openc3.files[places[1]].lstrip().startswith(b"#")


def test_over_rest_it_is_the_same_act_once_a_key_and_a_dry_run_sends_nothing(site, olga, yamcs):
    seen = {"If-Match": f'"v{version(site)}"', "X-CSRF-Token": olga.csrf_token}
    keyed = {**seen, "Idempotency-Key": "pass-4711"}

    def ask(headers, query="", system="yamcs"):
        return olga.send("POST", f"/api/v1/parameter-sets/1:hand-over{query}", json={"system": system}, headers=headers)

    trial = ask(keyed, "?validate_only=true")
    assert (trial.status_code, trial.json()["places"]) == (200, [])
    assert (yamcs.objects, _records(site, hand_over.BEGAN, hand_over.ENDED)) == ({}, [])
    answers = [ask(keyed) for _ in range(2)]
    (name,) = yamcs.objects
    assert [(one.status_code, one.json()["places"]) for one in answers] == [(200, [f"{BUCKET}/{name}"])] * 2
    assert yamcs.objects[name] == table(site)
    assert [one.action for one in _records(site, hand_over.BEGAN, hand_over.ENDED)] == [
        hand_over.BEGAN,
        hand_over.ENDED,
    ]
    assert ask(seen, system="openc3").status_code == 409
    yamcs.status = 503
    failed = ask(seen)
    assert (failed.status_code, failed.headers["content-type"]) == (503, "application/problem+json")
