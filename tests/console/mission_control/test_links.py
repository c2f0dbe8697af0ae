"""Telemetry that a policy pulls: each row of the archive once and none lost, however late, twice or badly it is answered."""

import contextlib
import json
from contextlib import closing
from datetime import UTC, datetime, timedelta
from itertools import chain, pairwise

import numpy as np
import pytest
from yamcs.client import YamcsClient

from boresight.console.alarms import rules as alarms
from boresight.console.alarms import service as alarm_steps
from boresight.console.alarms.queries import list_open_alarms
from boresight.console.ingest import policies
from boresight.console.ingest.rules import PolicyRules, parse_rules
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.jobs.mission_control import MissionControl
from boresight.console.list_queries import list_newest
from boresight.console.mission_control import queries as rows
from boresight.console.mission_control import service as links
from boresight.console.mission_control.tables import FAILURES_TOLD
from boresight.console.telemetry import profiles
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, RefusedInputError
from boresight.mission_control.archive import ArchiveRows, read_time_us
from boresight.platform.db.sessions import open_reading, open_writing, utc_text
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.telemetry.imports.builtin import BUILT_IN
from tests.effort import few_of
from tests.mission_control.yamcs_stand_in import INSTANCE, YamcsStandIn, serving
from tests.served import settings_in

BEGIN = datetime.now(UTC).replace(microsecond=0) - timedelta(hours=12)
MINUTE = timedelta(minutes=1)
FAST = {"pull_minutes": 1, "settle_minutes": 5, "longest_hours": 2, "lookback_hours": 4, "sets_per_day": 1000}


def profile_document():
    text = json.dumps({**BUILT_IN["yamcs"].to_dict(), "name": "tracker-a"})
    for begins in ("STAR{n}", "Q_", "TEMPERATURE"):
        text = text.replace(f'"{begins}', f'"/TRK/{begins}')
    return json.loads(text)


@pytest.fixture
def yamcs():
    return YamcsStandIn()


@pytest.fixture
def address(yamcs):
    with serving(yamcs.app) as found:
        yield found


class Ground:
    """A clock that is set, a policy that pulls, and what came of it."""

    def __init__(self, engine, blobs, people, catalogue, tmp_path, address, yamcs):
        self.engine, self.blobs, self.people, self.yamcs, self.now = engine, blobs, people, yamcs, BEGIN
        self.settings = settings_in(tmp_path / "data", yamcs_url=address, yamcs_instance=INSTANCE, yamcs_events="1")
        self.settings.data_folder.mkdir(exist_ok=True)
        self.sources = ForecastSources(blobs, lambda: catalogue, tmp_path / "catalogue")
        self.servers = [self.server(), self.server()]

    def server(self):
        return MissionControl(self.engine, self.sources, self.settings, lambda: None, lambda: self.now)

    def enable(self, **changed):
        with open_writing(self.engine) as session:
            key = str(profiles.save_profile(session, self.people["ana"], profile_document()).id)
            given = PolicyRules(**{"feed": "yamcs", "profile": key, **FAST, **changed}).to_dict()
            row = policies.draft(session, self.people["ana"], 1, given, "x")
            found = policies.compute_rehearsal(session, row.id)
            policies.record_rehearsal(session, self.people["ana"], row.id, found, row.version)
            policies.enable(session, self.people["root"], row.id, row.version)
            links.open_link(session, "yamcs", 1, utc_text(BEGIN))
            self.policy_id = row.id

    def archive(self, minutes):
        at = BEGIN + minutes * MINUTE
        at = at.replace(microsecond=at.microsecond // 1000 * 1000)
        stars = {f"/TRK/STAR{n}_{what}": 100.0 * n + minutes for n in range(1, 5) for what in ("ROW", "COL")}
        self.yamcs.put(at, stars)

    def pull(self, minutes, server=0):
        self.now = BEGIN + minutes * MINUTE
        self.servers[server]._pull(self.policy_id)

    def taken(self):
        """Return the times of each set's rows, as its file has them, in minutes since the beginning."""
        with open_reading(self.engine) as session:
            files = [
                self.blobs.read(row.source_sha256).decode() for row in list_newest(session, TelemetrySet, sensor=1)
            ]
        return [[_minutes(line) for line in text.splitlines()[1:]] for text in reversed(files)]

    def link(self):
        with open_reading(self.engine) as session:
            return rows.find_link(session, 1)

    def alarms(self):
        with open_writing(self.engine) as session:
            alarms.update_alarms(session)
        with open_reading(self.engine) as session:
            return {row.kind: row for row in list_open_alarms(session).values() if row.active}


def _minutes(line):
    return (read_time_us(line.split("\t")[0], "Yamcs") - read_time_us(BEGIN.isoformat(), "")) / 60e6


@pytest.fixture
def ground(engine, blobs, people, catalogue, tmp_path, address, yamcs):
    return Ground(engine, blobs, people, catalogue, tmp_path, address, yamcs)


def test_a_pass_becomes_one_set_once_it_is_over(ground):
    ground.enable()
    for minute in range(10):
        ground.archive(minute)
    ground.pull(11)
    assert ground.taken() == []  # under way
    assert ground.link().failures == 0
    ground.pull(15)
    assert ground.taken() == [list(range(10))]
    ground.pull(16)
    ground.pull(40)
    assert ground.taken() == [list(range(10))]
    with open_reading(ground.engine) as session:
        (decision,) = list_newest(session, IngestDecision, sensor=1)
        assert (decision.source, decision.state) == ("ARCHIVE", "CALIBRATING")


@pytest.mark.full
def test_what_comes_late_is_taken_alone_and_what_is_older_than_the_look_back_is_left(ground):
    ground.enable()
    for minute in (60, 62, 64):
        ground.archive(minute)
    ground.pull(75)
    for minute in (61, 63, 10):  # of an on-board recorder: 10 is within four hours too
        ground.archive(minute)
    ground.pull(90)
    assert ground.taken() == [[60, 62, 64], [10, 61, 63]]
    for _ in range(3):
        ground.pull(400)
    ground.archive(100)  # five hours late
    ground.pull(401)
    assert sum(map(len, ground.taken())) == 6


@pytest.mark.full
def test_a_pass_without_an_end_is_cut_and_an_outage_is_made_up_for_piece_by_piece(ground):
    ground.enable()
    for minute in range(0, 300, 5):
        ground.archive(minute)
    for minute in range(1, 302, 20):
        ground.pull(minute)
    assert len(ground.taken()) == 3  # two hours each, and what is left of five
    assert max(map(len, ground.taken())) <= 29
    ground.pull(700)
    ground.pull(701)
    ground.pull(702)
    ground.pull(703)
    assert sorted(chain(*ground.taken())) == list(range(0, 300, 5))


@pytest.mark.full
@pytest.mark.parametrize("seed", few_of(range(2), 1))
def test_each_row_is_taken_once_by_two_servers_over_an_archive_that_fails_and_fills_late(ground, seed, monkeypatch):
    ground.enable()
    chance = np.random.default_rng(seed)
    generated = np.unique(chance.integers(0, 480, 60)).tolist()
    arrives = {minute: minute + float(chance.choice([0.0, 3.0, 90.0, 200.0])) for minute in generated}
    waiting, lost = sorted(generated, key=arrives.get), 0
    note_taken = links.note_taken
    for minute in [*np.sort(chance.uniform(0, 700, 45)).tolist(), 900.0, 910.0, 920.0, 930.0, 940.0, 950.0]:
        while waiting and arrives[waiting[0]] <= minute:
            ground.archive(waiting.pop(0))
        is_last = minute >= 900
        ground.yamcs.status = None if is_last or chance.random() < 0.7 else int(chance.choice([500, 503, 401]))
        ground.yamcs.truncates = not is_last and chance.random() < 0.1

        def fails(*given, **named):
            note_taken(*given, **named)
            raise ConflictError("The transaction was lost; try again.")

        broken = not is_last and chance.random() < 0.2
        lost += broken
        monkeypatch.setattr(links, "note_taken", fails if broken else note_taken)
        with contextlib.suppress(ConflictError):
            ground.pull(minute, int(chance.integers(2)))
    assert lost > 2
    found = sorted(chain(*ground.taken()))
    assert found == generated


def test_two_servers_that_ask_at_once_take_a_range_once(ground):
    ground.enable()
    ground.archive(0)
    with open_reading(ground.engine) as session:
        asked = links.plan_range(rows.find_link(session, 1), PolicyRules(**FAST), links.count_us(BEGIN + 30 * MINUTE))
    ground.pull(30)
    with pytest.raises(ConflictError), open_writing(ground.engine) as session:
        links.note_taken(session, asked, ArchiveRows("", asked.taken_us, []), PolicyRules(**FAST))


def test_failures_wait_longer_each_time_then_raise_an_alarm_that_ends_by_itself(ground):
    ground.enable()
    ground.archive(0)
    ground.yamcs.status = 503
    waits = []
    for number in range(FAILURES_TOLD):
        assert "LINK" not in ground.alarms()
        began = datetime.now(UTC)
        ground.pull(20 + number)
        waits.append((datetime.fromisoformat(ground.link().due_utc) - began).total_seconds())
    assert [later / earlier > 1.8 for earlier, later in pairwise(waits)] == [True] * (FAILURES_TOLD - 1)
    alarm = ground.alarms()["LINK"]
    assert (alarm.sensor_id, alarm.level) == (1, "serious")
    ground.yamcs.status = None
    ground.pull(60)
    assert "LINK" not in ground.alarms()
    assert ground.taken() == [[0]]


@pytest.mark.full
def test_what_is_too_much_at_once_is_asked_for_in_halves(ground, monkeypatch):
    ground.enable()
    for minute in range(60):
        ground.archive(minute)
    monkeypatch.setattr("boresight.mission_control.yamcs.MOST_EXPORT_BYTES", 6000)
    for minute in range(100, 400, 15):
        ground.pull(minute)
    assert len(ground.taken()) > 1
    assert sorted(chain(*ground.taken())) == list(range(60))


def test_rows_that_cannot_be_telemetry_are_refused_on_record_and_not_asked_for_again(ground):
    ground.enable(failures_in_row=5)
    at = BEGIN.replace(microsecond=0)
    ground.yamcs.put(at, {"/TRK/STAR1_ROW": 1.0, "/TRK/STAR1_COL": 2.0, "/TRK/Q_X": 1.0})  # a part of a quaternion
    for minute in (20, 30):
        ground.pull(minute)
    with open_reading(ground.engine) as session:
        (decision,) = list_newest(session, IngestDecision, sensor=1)
    assert decision.state == "REFUSED"
    assert ground.taken() == []


def test_nothing_before_the_policy_was_enabled_is_pulled_and_a_paused_one_asks_nothing(ground):
    ground.enable()
    ground.yamcs.put(BEGIN - 10 * MINUTE, {"/TRK/STAR1_ROW": 1.0, "/TRK/STAR1_COL": 2.0})
    ground.pull(30)
    assert ground.taken() == []
    with open_writing(ground.engine) as session:
        row = session.get_one(IngestPolicy, ground.policy_id)
        policies.pause_by_person(session, ground.people["ana"], row.id, "x", row.version)
    asked = len(ground.yamcs.asked)
    ground.servers[0].pull()
    assert len(ground.yamcs.asked) == asked


def test_a_policy_wants_an_archive_that_exists_and_a_profile(ground):
    with open_writing(ground.engine) as session:
        for given in ({"feed": "yamcs"}, {"feed": "houston", "profile": "yamcs"}):
            with pytest.raises(RefusedInputError):
                policies.draft(session, ground.people["ana"], 1, given, "x")
    assert parse_rules({"preset": "x"}).feed == ""


def test_times_are_packed_into_next_to_nothing_and_read_again():
    times = np.arange(0, 2 * 86400 * 10**6, 500_000, dtype=np.int64) + 1_795_000_000_000_000
    assert len(links.pack_times(times)) < 10_000
    assert np.array_equal(links.unpack_times(links.pack_times(times)), times)
    assert links.unpack_times(links.pack_times(times[:0])).size == 0


def test_yamcs_is_told_of_alarms_once_in_order_and_again_after_it_failed(ground, address):
    server = ground.servers[0]
    server.tell_events()  # from now on
    with open_writing(ground.engine) as session:
        for kind in ("AGE", "DRIFT"):
            alarms._raise(session, alarms.AlarmCause(f"sensors/1/{kind}", 1, kind, "serious", f"{kind} it is."))
    ground.yamcs.status = 503
    server.tell_events()
    with open_reading(ground.engine) as session:
        link = rows.find_event_link(session, "yamcs")
    assert (link.failures, ground.yamcs.events) == (1, {})
    ground.yamcs.status = None
    with open_writing(ground.engine) as session:
        session.get_one(type(link), link.id).due_utc = "2026-01-01T00:00:00.000000Z"
        alarm_steps.record_step(
            session, ground.people["ana"], next(iter(list_open_alarms(session).values())), "COMMENTED", "x"
        )
    server.tell_events()
    server.tell_events()
    with closing(YamcsClient(address)) as client:
        told = list(client.get_archive(INSTANCE).list_events())
    assert [(one.event_type, one.severity) for one in told] == [("alarms.raised", "DISTRESS")] * 2
    assert [one.message.partition(". ")[2] for one in told] == ["AGE it is.", "DRIFT it is."]
    with open_reading(ground.engine) as session:
        assert rows.find_event_link(session, "yamcs").failures == 0
