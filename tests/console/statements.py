"""Counting what a page asks of its store."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa


@dataclass
class Asked:
    statements: int = 0
    rows: int = 0


@contextmanager
def counted(engine: Any) -> Iterator[Asked]:
    asked = Asked()

    def _statement(*event: Any) -> None:
        statement = event[2]
        asked.statements += not statement.startswith(("BEGIN", "COMMIT", "ROLLBACK", "PRAGMA", "SAVEPOINT"))

    @sa.event.listens_for(sa.orm.Session, "do_orm_execute")
    def _rows(state: Any) -> Any:
        if not state.is_select or state.session.get_bind().engine.pool is not engine.pool:
            return None  # another store's, whose server is at work behind another test
        result = state.invoke_statement().freeze()
        asked.rows += len(result().all())
        return result()

    sa.event.listen(engine, "before_cursor_execute", _statement)
    yield asked
    sa.event.remove(engine, "before_cursor_execute", _statement)
    sa.event.remove(sa.orm.Session, "do_orm_execute", _rows)
