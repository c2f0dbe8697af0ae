"""Any number of keys, bound as one value: the rows that Python would keep, by an index of their column."""

import pytest
import sqlalchemy as sa

from boresight.platform.db.documents import MOST_NUMBER, among
from boresight.platform.db.sessions import Engine, open_reading

KEYS = (1, 2, 3, 70_000, MOST_NUMBER - 1)
MANY = """
CREATE TEMPORARY TABLE many AS SELECT number, mod(number, 60) + 1 AS sensor_id FROM generate_series(1, 60000) AS number;
CREATE INDEX many_by_sensor ON many (sensor_id);
ANALYZE many
"""


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    return store


@pytest.mark.parametrize(
    "wanted",
    [[], [2], [3, 1, 3], [-1, 0, 4], [MOST_NUMBER - 1, MOST_NUMBER, 10**25], range(100_000), {1: "one"}.keys()],
    ids=["none", "one", "twice", "absent", "large", "many", "view"],
)
def test_the_rows_are_those_that_python_would_keep(store: Engine, wanted: object) -> None:
    keys = sa.union_all(*(sa.select(sa.literal(key, sa.Integer).label("key")) for key in KEYS)).subquery()
    kept = [key for key in KEYS if key in wanted]  # type: ignore[operator]
    with open_reading(store) as session:
        found = session.scalars(sa.select(keys.c.key).where(among(keys.c.key, wanted)).order_by(keys.c.key))  # type: ignore[arg-type]
        assert list(found) == kept
        left = sa.select(keys.c.key).where(sa.not_(among(keys.c.key, wanted))).order_by(keys.c.key)  # type: ignore[arg-type]
        assert list(session.scalars(left)) == [key for key in KEYS if key not in kept]


def test_postgresql_reads_by_the_index_where_one_of_sixty_is_named(postgresql: Engine) -> None:
    query = sa.select(sa.column("number")).select_from(sa.table("many")).where(among(sa.column("sensor_id"), [7]))
    with postgresql.connect() as connection:
        for statement in MANY.split(";"):
            connection.exec_driver_sql(statement)
        text = str(query.compile(connection, compile_kwargs={"literal_binds": True}))
        plan = "\n".join(row[0] for row in connection.exec_driver_sql(f"EXPLAIN {text}"))
    assert "many_by_sensor" in plan, plan
