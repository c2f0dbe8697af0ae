"""What the feed reads to tell what is new: that, and nothing that was told before."""

from pathlib import Path
from typing import Any

import pytest

from boresight.console.jobs.broadcast import EventCursor, events_after
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.audit import queries as audit_rows
from boresight.platform.db.sessions import open_reading, open_writing
from tests.stores import open_migrated, url_in


def test_one_new_record_is_told_without_reading_those_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = open_migrated(url_in(tmp_path))
    with open_writing(engine) as session:
        records = [audit.append(session, SYSTEM, "did", f"thing/{k}") for k in range(30)]
    *_, told, new = (record.id for record in records)
    read: list[int] = []
    rows_after = audit_rows.heads_after

    def noted(*given: Any) -> Any:
        page = rows_after(*given)
        read.append(len(page))
        return page

    monkeypatch.setattr(audit_rows, "heads_after", noted)
    with open_reading(engine) as session:
        events = events_after(session, EventCursor(0, told))
    assert [event.number for event in events] == [new]
    assert read == [1]
    engine.dispose()
