"""Runs are archived and restored one by one or together, each by its own authority, and lists leave out what is archived."""

import pytest

from boresight.console.runs import service as runs
from boresight.errors import ConflictError, ForbiddenError, NotFoundError
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading


def test_an_archived_run_is_left_out_until_it_is_restored_and_both_are_on_record(session, people, finished_run):
    first, second = finished_run(session), finished_run(session)
    for _ in range(2):
        runs.archive_run(session, people["ana"], first.id)
    assert [run.id for run in runs.list_runs(session, archived=False)] == [second.id]
    assert [run.id for run in runs.list_runs(session)] == [second.id, first.id]
    assert audit.find_last_change(session, f"runs/{first.id}").action == "archived"
    runs.restore_run(session, people["ana"], first.id)
    assert [run.id for run in runs.list_runs(session, archived=False)] == [second.id, first.id]
    assert audit.find_last_change(session, f"runs/{first.id}").action == "restored"


def test_only_an_analyst_archives_and_only_what_has_ended(session, people, finished_run):
    ended, running = finished_run(session), finished_run(session, state="RUNNING")
    for name in ("cy", "dee", "eve", "root"):
        for act in (runs.archive_run, runs.restore_run):
            with pytest.raises(ForbiddenError):
                act(session, people[name], ended.id)
    with pytest.raises(ConflictError):
        runs.archive_run(session, people["ana"], running.id)
    with pytest.raises(NotFoundError):
        runs.archive_run(session, people["ana"], 99)


def _batch(visitor, act, numbers):
    return visitor.post("/runs/batch", act=act, runs=",".join(map(str, numbers)))


def test_of_several_runs_each_is_told_by_itself(site, read):
    waiting = site.add_run(label="waits")
    answer = _batch(site.visitor("ada"), "archive", [1, waiting, 99])
    assert answer.status_code == 200
    page = read(answer.text)
    for said in ("Archived: hidden from lists.", f"Run {waiting} is QUEUED", "There is no run 99"):
        assert said in page
    listed, whole = (site.visitor("ada").get(address) for address in ("/runs", "/runs?archived=1"))
    assert 'href="/runs/1">#1<' not in listed
    assert 'href="/runs/1">#1</a> <span class="tag">archived</span>' in whole
    assert "\r\n1," not in site.visitor("ada").get("/runs.csv")
    _batch(site.visitor("ada"), "restore", [1])
    assert 'href="/runs/1">#1<' in site.visitor("ada").get("/runs")


def test_several_runs_are_assessed_each_with_its_verdict(site, read):
    waiting = site.add_run(label="waits")
    page = _batch(site.visitor("ada"), "assess", [1, 2, waiting]).text
    assert page.count('/gates">') == 2
    assert f"Run {waiting} is QUEUED" in read(page)
    with open_reading(site.engine) as session:
        assert {audit.find_last_change(session, f"parameter-sets/{n}/gate-report").action for n in (2, 3)} == {
            "assessed"
        }


@pytest.mark.parametrize(("act", "numbers"), [("erase", [1]), ("assess", []), ("assess", range(1, 22))])
def test_an_act_that_is_none_and_too_few_or_many_runs_are_refused(site, act, numbers):
    assert _batch(site.visitor("ada"), act, numbers).status_code == 422


def test_who_is_no_analyst_is_told_so_of_each_run_and_nothing_changes(site, read):
    assert 'action="/runs/batch"' not in site.visitor("victor").get("/runs")
    for act in ("archive", "assess"):
        assert read(_batch(site.visitor("victor"), act, [1, 2]).text).count("role analyst") == 2
    assert 'href="/runs/1">#1<' in site.visitor("ada").get("/runs")
