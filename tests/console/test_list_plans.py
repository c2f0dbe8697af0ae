"""The lists as SQLite means to read them: the first views sort nothing, and the filters of every day have their index."""

import pytest
from sqlalchemy import event

from boresight.console import list_queries as lists
from boresight.console.list_queries import LISTS, ListQuery
from boresight.platform.db.lists import list_newest_rows
from boresight.platform.db.sessions import open_reading
from tests.stores import open_migrated

FIRST = {
    "sensors": "sensor",
    "runs": "-run",
    "telemetry": "-uploaded",
    "parameter-sets": "-set",
    "approvals": "-request",
    "audit": "-number",
    "alignments": "-alignment",
    "alignment-requests": "-request",
    "campaigns": "-campaign",
    "campaign-sensors": "launched",
    "change-proposals": "-proposal",
    "ingest-decisions": "-decision",
}
SORTED_BY_THE_CLOCK = {"alarms"}  # one on the shelf comes back by time alone, so that no index knows the order


@pytest.fixture
def session(tmp_path):
    engine = open_migrated(f"sqlite:///{tmp_path}/store.sqlite3")
    with open_reading(engine) as opened:
        yield opened
    engine.dispose()


def explain(session, text, parameters=()):
    return [row[3] for row in session.connection().exec_driver_sql(f"EXPLAIN QUERY PLAN {text}", parameters)]


def plan(session, name, asked):
    query = lists._ids(session, LISTS[name], asked).limit(51)
    return explain(session, str(query.compile(session.get_bind(), compile_kwargs={"literal_binds": True})))


def plan_of_newest(session, name, **asked):
    """Return how SQLite reads the newest rows of a list, by the statement that was sent."""
    sent = []
    engine = session.get_bind()

    def note(_connection, _cursor, statement, parameters, _context, _many):
        sent.append((statement, parameters))

    event.listen(engine, "before_cursor_execute", note)
    list_newest_rows(session, LISTS[name], limit=51, **asked)
    event.remove(engine, "before_cursor_execute", note)
    return [
        step
        for statement, parameters in sent
        if statement.startswith("SELECT")
        for step in explain(session, statement, parameters)
    ]


@pytest.mark.parametrize("before_id", [None, 30])
@pytest.mark.parametrize("name", FIRST)
def test_the_first_view_of_a_list_reads_its_page_and_sorts_nothing(session, name, before_id):
    steps = plan(session, name, ListQuery({}, FIRST[name], before_id))
    assert not any("TEMP B-TREE" in step for step in steps), steps


def test_every_list_that_is_sorted_by_keys_has_a_first_view():
    assert {*FIRST, *SORTED_BY_THE_CLOCK} == {name for name, known in LISTS.items() if known.keys}


@pytest.mark.parametrize("before_id", [None, 30])
@pytest.mark.parametrize("name", LISTS)
def test_the_newest_rows_of_a_list_are_read_in_the_order_of_their_ids_and_sorted_by_nothing(session, name, before_id):
    steps = plan_of_newest(session, name, before_id=before_id)
    assert len(steps) == 1
    assert "TEMP B-TREE" not in steps[0]


@pytest.mark.parametrize(
    ("name", "where"), [("alarms", "sensor"), ("packages", "set"), ("uplinks", "set"), ("deliveries", "webhook")]
)
def test_the_newest_rows_of_one_owner_come_in_the_order_of_their_index(session, name, where):
    steps = plan_of_newest(session, name, **{where: 1})
    assert len(steps) == 1
    assert "USING INDEX" in steps[0]


@pytest.mark.parametrize(
    ("name", "where"),
    [("runs", "sensor"), ("runs", "state"), ("telemetry", "sensor"), ("parameter-sets", "sensor"), ("audit", "object")],
)
def test_a_filter_of_every_day_has_its_index(session, name, where):
    steps = plan(session, name, ListQuery({where: "1"}, FIRST[name]))
    assert steps
    assert all("USING COVERING INDEX" in step for step in steps), steps
