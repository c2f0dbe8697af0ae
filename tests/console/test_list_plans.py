"""The lists as SQLite means to read them: the first views sort nothing, and the filters of every day have their index."""

import pytest

from boresight.console import list_queries as lists
from boresight.console.list_queries import LISTS, ListQuery
from boresight.platform.db.sessions import open_reading
from tests.stores import open_migrated

FIRST = {
    "sensors": "sensor",
    "runs": "-run",
    "telemetry": "-uploaded",
    "parameter-sets": "-set",
    "approvals": "-request",
    "audit": "-number",
}


@pytest.fixture
def session(tmp_path):
    engine = open_migrated(f"sqlite:///{tmp_path}/store.sqlite3")
    with open_reading(engine) as opened:
        yield opened
    engine.dispose()


def plan(session, name, asked):
    query = lists._ids(session, LISTS[name], asked).limit(51)
    text = str(query.compile(session.get_bind(), compile_kwargs={"literal_binds": True}))
    return [row[3] for row in session.connection().exec_driver_sql(f"EXPLAIN QUERY PLAN {text}")]


@pytest.mark.parametrize("before_id", [None, 30])
@pytest.mark.parametrize("name", LISTS)
def test_the_first_view_of_a_list_reads_its_page_and_sorts_nothing(session, name, before_id):
    steps = plan(session, name, ListQuery({}, FIRST[name], before_id))
    assert not any("TEMP B-TREE" in step for step in steps), steps


@pytest.mark.parametrize(
    ("name", "where"),
    [("runs", "sensor"), ("runs", "state"), ("telemetry", "sensor"), ("parameter-sets", "sensor"), ("audit", "object")],
)
def test_a_filter_of_every_day_has_its_index(session, name, where):
    steps = plan(session, name, ListQuery({where: "1"}, FIRST[name]))
    assert steps
    assert all("USING COVERING INDEX" in step for step in steps), steps
