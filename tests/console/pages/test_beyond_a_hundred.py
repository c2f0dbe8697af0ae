"""What is counted or sought is counted and sought among all there is, however many rows there are."""

from __future__ import annotations

import re
from collections import Counter

import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access import sessions as session_list
from boresight.console.access.tables import LoginSession
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import Alarm
from boresight.console.alignments import queries as alignment_queries
from boresight.console.approvals import gate_profiles
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.backups import pages as backup_pages
from boresight.console.backups import service as backups
from boresight.console.backups.tables import Backup, BackupSchedule
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.change_proposals import queries as proposal_queries
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet import pointings
from boresight.console.fleet.pages import overview
from boresight.console.fleet.tables import Sensor
from boresight.console.notes import queries as note_queries
from boresight.console.notes import service as notes
from boresight.console.notes.tables import Note
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_queries
from boresight.console.runs import service as runs
from boresight.console.runs.pages.run import find_parameter_set
from boresight.console.runs.tables import ArchivedRun, Run, RunEvent
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.uplinks import packages
from boresight.console.uplinks.tables import Package
from boresight.platform.actors import COMMAND_LINE, POLICY
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing, utc_now
from tests.console.statements import counted

MANY = 130
ADA, ALAN, BOTH = 1, 2, 6


def like(row, **changed):
    """Return a row of the same table with other values."""
    columns = {one.key: getattr(row, one.key) for one in sa.inspect(type(row)).column_attrs if one.key != "id"}
    return type(row)(**columns | changed)


def fill(site, state="OPEN", submitted_by=None):
    """Give sensor 1 runs, each with a set; every set has a request, and different people had their hands in them."""
    with open_writing(site.engine) as session:
        run, ground = session.get_one(Run, 1), session.scalar(sa.select(ParameterSet))
        for number in range(1, MANY + 1):
            launched_by = BOTH if number % 5 == 0 else ADA
            made = like(run, launched_by=launched_by)
            session.add(made)
            session.flush()
            of_run = like(
                ground, name=f"PS-MANY-{number}", number=number, run_id=made.id, ground_state="SUBMITTED", baseline_from_utc=None,
                created_by=BOTH if number % 7 == 0 else ADA, sha256=f"{number:064x}",
            )  # fmt: skip
            session.add(of_run)
            session.flush()
            request = Approval(
                parameter_set_id=of_run.id, state=state, submitted_utc=utc_now(), reason="It fits.",
                submitted_by=submitted_by or (BOTH if number % 3 == 0 else ADA), bound={},
                expires_utc="2000-01-01T00:00:00.000000Z" if number % 11 == 0 else "2999-01-01T00:00:00.000000Z",
            )  # fmt: skip
            session.add(request)
            session.flush()
            if number % 13 == 0:
                session.add(
                    Signature(
                        approval_id=request.id, user_id=ALAN, printed_name="Alan Approver", decision="APPROVE",
                        meaning="I approve.", comment="",
                        shown_sha256="0" * 64, signed_utc=utc_now(),
                    )
                )  # fmt: skip
            if number % 17 == 0:
                campaign = Campaign(label="c", settings={}, launched_by=BOTH, launched_utc=utc_now())
                session.add(campaign)
                session.flush()
                session.add(CampaignRun(campaign_id=campaign.id, sensor_id=1, run_id=made.id))
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
    return site


@pytest.fixture
def full(site):
    return fill(site)


def shown(page):
    """Return what the top bar says of requests."""
    return int(
        re.search(r'Approvals<span class="sr"> waiting</span></span><b class="badge[^"]*">([\d\u202f,]+)', page)[1]
    )


def count_in(page, words):
    """Return the number that stands before some words."""
    return int(re.search(rf"(\d+) {words}", page)[1])


def test_every_open_request_is_counted_in_the_top_bar(full):
    assert shown(full.visitor("victor").get("/audit")) == MANY


@pytest.mark.few(4)
@pytest.mark.parametrize("name", ["alan", "both", "ada", "adele", "olga"])
@pytest.mark.parametrize("four_eyes", [True, False])
def test_the_requests_open_to_somebody_are_those_that_they_may_sign_one_by_one(full, name, four_eyes):
    policy, actor = type(POLICY)(**{**vars(POLICY), "four_eyes": four_eyes}), full.actor(name)
    with open_reading(full.engine) as session:
        requests = lists.list_newest(session, Approval, state="OPEN")
        may = {
            one.id for one in requests if approvals.explain_why_not_sign(session, actor, one.id, policy=policy) is None
        }
        who = approvals.find_signatory(session, actor, policy=policy)
        found = set() if who is None else {
            one.id for one in lists.read_page(session, "approvals", {"open_to": who}, "-request", limit=MANY)
        }  # fmt: skip
        counted_ones = 0 if who is None else lists.count(session, "approvals", {"open_to": who})
    assert len(requests) == MANY
    assert found == may
    assert counted_ones == len(may)
    assert (len(may) > 100) == (name == "alan" or (name == "both" and not four_eyes))
    assert bool(may) == (name in {"alan", "both"})


def test_the_overview_counts_what_waits_for_a_signature_and_reads_what_it_shows(full, read):
    visitor = full.visitor("alan")
    visitor.get("/")
    with counted(full.engine) as asked:
        page = read(visitor.get("/?again=1"))
    waiting = count_in(page, "requests waiting for your signature")
    assert waiting == MANY - 11 - 10  # expired, and signed already; none is both
    assert page.count("is waiting for your signature.") == 8
    assert count_in(page, "more") == waiting - 8
    assert asked.statements <= 40
    assert asked.rows < 250  # how the fleet stands names the set of every open request; nothing else grows with them


def test_the_overview_counts_what_came_back_approved_sets_baselines_and_alarms_beyond_a_hundred(site, read):
    fill(site, state="STALE", submitted_by=ADA)
    with open_writing(site.engine) as session:
        sensor, ground = session.get_one(Sensor, 1), session.scalar(sa.select(ParameterSet))
        for number in range(2, MANY + 2):
            other = like(sensor, name=f"Fleet-{number}")
            session.add(other)
            session.flush()
            made = like(session.get_one(Run, 1), sensor_id=other.id)
            session.add(made)
            session.flush()
            for place, state in enumerate(("BASELINE", "APPROVED")):
                name = f"PS-{state}-{number}"
                session.add(
                    like(ground, name=name, sensor_id=other.id, number=place, run_id=made.id, ground_state=state)
                )
            session.add(
                Alarm(
                    source=f"sensors/{other.id}/DRIFT", sensor_id=other.id, kind="DRIFT", level="serious",
                    sentence="It drifts.", evidence={}, raised_utc=utc_now(),
                )
            )  # fmt: skip
        audit.append(session, COMMAND_LINE, "brought in", "sensors")
    with open_reading(site.engine) as session:
        alarms_in_all = alarms.count_unacknowledged(session)
    assert alarms_in_all >= MANY
    olga = read(site.visitor("olga").get("/"))
    assert count_in(olga, "more") == alarms_in_all * ("Alarm" in olga) + 2 * MANY - 8
    page = site.visitor("ada").get("/")
    assert page.count(">ALARM</span>") >= 100  # of the sensors that are drawn, however many alarms are newer
    assert count_in(read(page), "more") >= MANY - 8


def test_the_overview_counts_every_sensor_whose_newest_run_failed_whatever_it_draws(site, read):
    with open_writing(site.engine) as session:
        sensor = session.get_one(Sensor, 1)
        for number in range(2, MANY + 2):
            other = like(sensor, name=f"Fleet-{number}")
            session.add(other)
            session.flush()
            session.add(like(session.get_one(Run, 1), sensor_id=other.id, state="FAILED", reason="x", summary=None))
        audit.append(session, COMMAND_LINE, "brought in", "sensors")
    page = site.visitor("ada").get("/")
    assert page.split('id="fleet"')[1].split("</table>")[0].count('<th scope="row">') == overview.MOST_TILES < MANY
    assert count_in(read(page), "more") == MANY + 1 - overview.MOST_ACTIONS  # and run 1, which converged


def test_no_note_proposal_log_in_or_version_is_left_out_beyond_a_hundred(site, read):
    many = 2 * MANY
    site.visitor("ada").get("/sensors/1/gates")
    with open_writing(site.engine) as session:
        first = gate_profiles.list_profiles(session, 1)[0]
        session.add(first)
        session.flush()
        for number in range(1, many + 1):
            when = utc_now()
            session.add_all((
                Note(subject_kind="runs", subject_id=1, user_id=ADA, printed_name="Ada", text="n", made_utc=when),
                ChangeProposal(
                    sensor_id=1, kind="gate-profile", base_number=0, document={}, sha256=f"{number:064x}", reason="r",
                    proposed_utc=when, proposed_by=ADA, expires_utc="2999-01-01T00:00:00.000000Z", state="OPEN",
                ),
                LoginSession(user_id=ADA, token_hash=str(number), created_utc=when, last_used_utc=when, address="", user_agent=""),
                like(first, number=first.number + number, sha256=f"{number:064x}"),
            ))  # fmt: skip
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
    with open_reading(site.engine) as session:
        assert note_queries.count_notes(session, "runs", 1) == len(notes.list_notes(session, "runs", 1)) == many
        assert (
            proposal_queries.count_open_proposals(session)
            == len(proposals.list_proposals(session, state="OPEN"))
            == many
        )
        assert len(session_list.list_sessions(session, site.actor("ada"), is_open=True)) > many
    visitor = site.visitor("ada")
    assert f"{many} notes" in " ".join(read(visitor.get("/runs/1")).split())
    assert visitor.get("/sensors/1/gates").count("<tr") > many


def test_a_run_finds_its_set_however_many_are_newer(full):
    with open_reading(full.engine) as session:
        oldest = session.scalar(sa.select(sa.func.min(ParameterSet.run_id)))
        newer = lists.list_newest(session, ParameterSet, sensor=1, limit=100)
        made = find_parameter_set(session, runs.get_run(session, oldest))
        assert made.run_id == oldest
        assert made.id not in {row.id for row in newer}
    assert made.name in full.visitor("ada").get(f"/runs/{oldest}")


def test_a_set_of_telemetry_finds_its_runs_and_how_many_there_are_behind_hundreds_of_others(full):
    with open_writing(full.engine) as session:
        digest = session.get_one(Run, 1).result_sha256
        other = like(session.get_one(TelemetrySet, 1), name="later", original_sha256=digest)
        session.add(other)
        session.flush()
        row = session.get_one(Run, 1)
        session.add_all(like(row, telemetry_set_id=other.id, validation_set_id=None) for _ in range(520))
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
    with open_reading(full.engine) as session:
        for number in (1, 2):  # fitted with, and validated with
            newest, uses = run_queries.list_runs_of_set(session, number, 100)
            assert (len(newest), uses) == (100, MANY + 2)
        assert run_queries.list_runs_of_set(session, other.id, 100)[1] == 520


def test_a_run_in_a_long_queue_knows_its_place(site, read):
    for _ in range(3):
        site.add_run()
    with open_writing(site.engine) as session:
        waiting = session.scalar(sa.select(Run).where(Run.state == "QUEUED"))
        session.add_all(like(waiting) for _ in range(600))
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
    with open_reading(site.engine) as session:
        last = session.scalar(sa.select(sa.func.max(Run.id)))
    assert "Position 603 " in read(site.visitor("ada").get(f"/runs/{last}"))


def test_the_newest_result_with_a_validation_set_is_found_behind_many_without(site):
    with open_writing(site.engine) as session:
        session.add_all(like(session.get_one(Run, 1), validation_set_id=None) for _ in range(MANY))
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
    with open_reading(site.engine) as session:
        found = list(run_queries.iterate_newest_finished(session, 1))
        assert found[0].id == 2
        assert len(found) == len({run.id for run in found}) > MANY
        order = [(run.validation_set_id is None, -run.id) for run in found]
        assert order == sorted(order)


def test_a_long_log_is_given_whole(site):
    with open_writing(site.engine) as session:
        session.add_all(
            RunEvent(run_id=1, attempt=1, at_utc=utc_now(), kind="log", message=f"line {k}") for k in range(1500)
        )
    visitor = site.visitor("ada")
    assert len(visitor.get("/runs/1/log").splitlines()) == 1500
    answer, messages, path = None, [], "/api/v1/runs/1/log?limit=200"
    while path:
        answer = visitor.send("GET", path).json()
        messages += [line["message"] for line in answer["items"]]
        path = answer["next"] and f"/api/v1/runs/1/log?limit=200&cursor={answer['next']}"
    assert messages == [f"line {k}" for k in range(1500)]


def test_a_package_is_found_again_behind_a_hundred_others(site):
    with open_writing(site.engine) as session:
        row = session.scalar(sa.select(ParameterSet))
        sha256 = session.get_one(TelemetrySet, 1).original_sha256
        session.add_all(
            Package(parameter_set_id=row.id, inputs={"of": number}, sha256=sha256, created_utc=utc_now())
            for number in range(MANY)
        )
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
        session.flush()
        assert packages._find_existing(session, row, {"of": 0}, signed=False).inputs == {"of": 0}


def test_no_version_of_the_limits_is_lost_over_rest(site):
    site.visitor("ada").get("/sensors/1/gates")
    with open_writing(site.engine) as session:
        first = gate_profiles.list_profiles(session, 1)[0]
        session.add(first)
        session.flush()
        numbers = range(first.number + 1, first.number + 1 + MANY)
        session.add_all(like(first, number=number, sha256=f"{number:064x}") for number in numbers)
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
        assert len(gate_profiles.list_profiles(session, 1)) == MANY + 1
    found, path, visitor = [], "/api/v1/sensors/1/gate-profiles?limit=50", site.visitor("ada")
    while path:
        answer = visitor.send("GET", path).json()
        found += [item["number"] for item in answer["items"]]
        path = answer["next"] and f"/api/v1/sensors/1/gate-profiles?limit=50&cursor={answer['next']}"
    assert found == [*reversed(numbers), numbers[0] - 1]


def test_a_plan_starts_from_the_baseline_and_a_converged_run_however_many_others_are_newer(site):
    baseline_run = site.add_run(state="SUCCEEDED", summary={"status": "converged"})
    archived = site.add_run(state="SUCCEEDED", summary={"status": "converged"})
    with open_writing(site.engine) as session:
        ground = session.scalar(sa.select(ParameterSet))
        ground.ground_state = "SUPERSEDED"
        session.add(ArchivedRun(run_id=archived, archived_utc=utc_now()))
        session.flush()
        baseline = like(ground, name="PS-BASE", number=1, run_id=baseline_run, ground_state="BASELINE")
        session.add(baseline)
        session.flush()
        for number in range(2, pointings.MOST_OFFERED + 3):
            ended = {"status": "max_iterations"}
            made = like(session.get_one(Run, 1), summary=ended)
            session.add(made)
            session.flush()
            session.add(like(ground, name=f"PS-{number}", number=number, run_id=made.id, ground_state="CANDIDATE"))
        audit.append(session, COMMAND_LINE, "brought in", "sensors/1")
        session.flush()
        sets, found = pointings.list_known(session, session.get_one(Sensor, 1))
        assert [row.id for row in sets] == [baseline.id]
        assert baseline_run in {run.id for run in found}
        assert archived not in {run.id for run in found}
        assert all(run.summary["status"] == "converged" for run in found)
    page = site.visitor("ada").get("/sensors/1/plan")
    assert f'<option value="set {baseline.id}" selected' in page
    assert f'<option value="run {baseline_run}"' in page


def test_an_alignment_is_offered_the_newest_runs_of_each_sensor_however_many_another_has(site):
    many = 220
    with open_writing(site.engine) as session:
        run = session.get_one(Run, 1)
        other = like(session.get_one(Sensor, 1), name="Other")
        session.add(other)
        session.flush()
        session.add_all(like(run, sensor_id=other.id) for _ in range(many))
        audit.append(session, COMMAND_LINE, "brought in", "sensors")
        session.flush()
        found = alignment_queries.list_usable_runs(session, 3)
    assert [row.id for row in found] == sorted((row.id for row in found), reverse=True)
    assert Counter(row.sensor_id for row in found) == {other.id: 3, 1: 2}
    assert found[0].id == max(row.id for row in found) >= many
    page = site.visitor("ada").get("/alignments/new")
    assert [len(re.findall(rf": run {number}\b", page)) for number in (1, 2)] == [2, 2]  # for A and for B


def test_every_backup_is_listed_a_page_at_a_time(site):
    many = 2 * backup_pages.ROWS_A_PAGE + 7
    with open_writing(site.engine) as session:
        schedule = BackupSchedule(
            destination="/elsewhere", at_minute=0, every_hours=1, keep_daily=1, keep_weekly=0, keep_monthly=0, created_utc=utc_now()
        )  # fmt: skip
        session.add(schedule)
        session.flush()
        session.add_all(
            Backup(
                schedule_id=schedule.id, due_utc=utc_now(), state="SUCCEEDED", attempt=1, name=f"n-{number:03d}.backup",
                started_utc=utc_now(),
            )
            for number in range(many)
        )  # fmt: skip
        audit.append(session, COMMAND_LINE, "brought in", "backups")
        session.flush()
        assert len(backups.list_backups(session)) == many
    visitor, path, pages = site.visitor("ada"), "/backups", []
    while path:
        page = visitor.get(path)
        pages.append(re.findall(r"n-(\d{3})\.backup", page))
        older = re.search(r'href="(/backups\?before=\d+)"', page)
        path = older and older[1]
    assert [len(names) for names in pages] == [50, 50, 7]
    assert [int(name) for names in pages for name in names] == [*range(many)][::-1]


def test_the_palette_finds_an_alarm_by_its_sentence_however_many_are_newer(site):
    with open_writing(site.engine) as session:
        for number in range(2 * MANY):
            sentence = "The Xylophone drifts by 100 %_." if number == 0 else "It drifts."
            session.add(
                Alarm(
                    source=f"sensors/1/{number}", sensor_id=1, kind="DRIFT", level="serious", sentence=sentence, evidence={},
                    raised_utc=utc_now(),
                )
            )  # fmt: skip
            session.flush()
        audit.append(session, COMMAND_LINE, "brought in", "sensors")
        number = session.scalar(sa.select(sa.func.min(Alarm.id)).where(Alarm.sentence.contains("Xylophone")))
    visitor = site.visitor("victor")
    for text, expected in (("xylophone", [number]), ("100 %_", [number]), ("0%_", [])):
        found = visitor.send("GET", "/search", params={"q": text}).json()["found"]
        assert [one["href"] for one in found if one["kind"] == "Alarm"] == [f"/alarms/{one}" for one in expected]
