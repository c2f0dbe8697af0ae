"""Documents: one spelling each; any number of keys, bound as one value, by an index of their column."""

import json

import pytest
import sqlalchemy as sa
from hypothesis import given
from hypothesis import strategies as st

from boresight.platform.db.documents import MOST_NUMBER, among, canonical, compute_sha256, read
from boresight.platform.db.sessions import Engine, open_reading

NUMBERS = (
    st.integers(-(2**63), 2**63)
    | st.integers()
    | st.integers(10**17, 10**40)
    | st.floats(allow_nan=False, allow_infinity=False)
)
JSON = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=20,
)


@given(document=JSON)
def test_a_document_read_back_has_the_same_spelling(document: object) -> None:
    assert canonical(json.loads(canonical(document))) == canonical(document)


@given(document=JSON)
def test_the_fast_reader_reads_what_the_plain_one_does(document: object) -> None:
    spelling = canonical(document)
    assert repr(read(spelling)) == repr(json.loads(spelling))


@given(document=st.dictionaries(st.text(max_size=8), JSON, min_size=2))
def test_the_order_of_keys_does_not_matter(document: dict[str, object]) -> None:
    backwards = dict(reversed(document.items()))
    assert compute_sha256(backwards) == compute_sha256(document)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
def test_what_json_cannot_say_is_refused(number: float) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        canonical({"f_m": number})


def test_the_spelling_is_fixed() -> None:
    document = {"b": [1.0, 1e22, -0.0, 0.1], "a": {"ψ": None, "n": 3}}
    assert canonical(document) == '{"a":{"n":3,"ψ":null},"b":[1.0,1e+22,-0.0,0.1]}'


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


@pytest.mark.full
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
