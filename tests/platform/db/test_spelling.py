"""How SQLite spells the schema: what the migrations made is, part for part, what the models say, and every table is STRICT."""

from itertools import accumulate
from typing import Any

from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Engine, open_engine


def test_every_table_and_index_is_spelled_as_the_models_spell_it(sqlite: Engine, tmp_path: Any) -> None:
    direct = open_engine(f"sqlite:///{tmp_path}/direct.sqlite3")
    with direct.begin() as connection:
        Base.metadata.create_all(connection)
    migrated, modelled = _spelling(sqlite), _spelling(direct)
    assert {name: _parts(sql) for name, sql in migrated.items()} == {
        name: _parts(sql) for name, sql in modelled.items()
    }
    direct.dispose()


def _parts(sql: str) -> set[str]:
    head, _, rest = sql.partition("(")
    body, _, tail = rest.rpartition(")")
    depths = accumulate((letter == "(") - (letter == ")") for letter in body)
    cut = "".join("\n" if letter == "," and depth == 0 else letter for letter, depth in zip(body, depths, strict=True))
    return {head.strip().replace('"', ""), tail.strip(), *(part.strip().replace('"', "") for part in cut.split("\n"))}


def _spelling(engine: Engine) -> dict[str, str]:
    query = "SELECT name, sql FROM sqlite_master WHERE type IN ('table', 'index') AND sql IS NOT NULL"
    with engine.connect() as connection:
        rows = connection.exec_driver_sql(query)
        return {name: " ".join(sql.split()) for name, sql in rows if name != "alembic_version"}


def test_every_table_is_strict(sqlite: Engine) -> None:
    tables = {name: sql for name, sql in _spelling(sqlite).items() if sql.startswith("CREATE TABLE")}
    assert len(tables) == len(Base.metadata.tables)
    assert all(sql.endswith("STRICT") for sql in tables.values())
