"""Telemetry sets: kept as they came and as the table, once; a refusal stores nothing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy as sa

from boresight.calibration.calibration import to_plain
from boresight.console.fleet.tables import Sensor
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.tables import TelemetrySet, parse_quality
from boresight.errors import ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.telemetry.quality.report import QualityReport
from boresight.telemetry.working_table import WorkingTable, is_working_table
from tests.refusals import has_code

People = Mapping[str, Actor]
HEADER = "frame,exposure,row_px,col_px,star_id,ra_deg,dec_deg,note\n"


def _csv(frames: int = 3, stars: int = 5) -> str:
    rng = np.random.default_rng(20261121)
    lines = [
        f"{frame},0,{rng.uniform(0, 1900):.3f},{rng.uniform(0, 2500):.3f},{star + 1},{10 + star}.0,{star}.5,ok"
        for frame in range(frames)
        for star in range(stars)
    ]
    return HEADER + "\n".join(lines) + "\n"


@pytest.fixture
def file(tmp_path) -> Path:
    """An upload as a door keeps it: without the sender's suffix."""
    path = tmp_path / "upload"
    path.write_text(_csv(), encoding="utf-8")
    return path


def _add(
    engine: Engine,
    actor: Actor,
    blobs: BlobStore,
    path: Path,
    file_name: str = "pass 12.csv",
    purpose: str = "calibration",
    sensor_id: int = 1,
) -> TelemetrySet:
    with open_writing(engine) as session:
        return telemetry_sets.add_telemetry_set(session, actor, blobs, None, sensor_id, path, file_name, purpose)


def _stored(engine: Engine, blobs: BlobStore) -> tuple[int, int, int, int]:
    """Count files, their rows, sets and audit records."""
    files = sum(path.is_file() for path in blobs.folder.rglob("*")) if blobs.folder.exists() else 0
    with open_reading(engine) as session:
        rows = [
            session.scalar(sa.select(sa.func.count()).select_from(table)) or 0
            for table in (Blob, TelemetrySet, AuditRecord)
        ]
    return (files, *rows)


def test_an_upload_is_kept_as_it_came_and_as_a_table_that_reads_back_as_what_was_sent(engine, people, blobs, file):
    row = _add(engine, people["ana"], blobs, file)
    assert (row.name, row.purpose, row.frames, row.stars) == ("pass 12.csv", "calibration", 3, 15)
    assert blobs.read(row.original_sha256) == file.read_bytes()
    assert is_working_table(blobs.path(row.table_sha256))
    assert row.uploaded_by == people["ana"].user_id
    assert row.quality["frames"] == 3
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"telemetry-sets/{row.id}")
        assert record.action == "uploaded"
    telemetry = WorkingTable(blobs.path(row.table_sha256)).read()
    sent = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=(0, 2, 3, 5)).T
    sent[3] = np.radians(sent[3])
    kept = (telemetry.frame, telemetry.row_px, telemetry.col_px, telemetry.ra_rad)
    assert all(np.array_equal(*pair) for pair in zip(kept, sent, strict=True))


def test_the_same_bytes_again_are_the_set_that_is_there(engine, people, blobs, file):
    first = _add(engine, people["ana"], blobs, file)
    before = _stored(engine, blobs)
    again = _add(engine, people["bo"], blobs, file, file_name="another name.csv")
    assert (again.id, again.name) == (first.id, first.name)
    assert _stored(engine, blobs) == before


def test_the_same_bytes_prepared_twice_at_once_are_stored_once(engine, people, blobs, file):
    with open_reading(engine) as session:
        document = session.get_known(Sensor, 1).document
    ids = set()
    with (
        telemetry_sets.hold_prepared(document, None, file, "a.csv") as one,
        telemetry_sets.hold_prepared(document, None, file, "b.csv") as other,
    ):
        for upload in (one, other):
            with open_writing(engine) as session:
                ids.add(telemetry_sets.store_prepared(session, people["ana"], blobs, 1, upload).id)
    assert len(ids) == 1


def test_an_archived_set_comes_back_with_its_bytes(engine, people, blobs, file):
    row = _add(engine, people["ana"], blobs, file)
    with open_writing(engine) as session:
        telemetry_sets.archive_telemetry_set(session, people["ana"], row.id)
        assert telemetry_sets.list_telemetry_sets(session) == []
        assert len(telemetry_sets.list_telemetry_sets(session, archived=True)) == 1
    assert _add(engine, people["ana"], blobs, file).archived_utc is None


@pytest.mark.parametrize(
    ("content", "file_name", "says"),
    [
        (b"", "a.csv", "empty"),
        (b"frame,exposure\n1,0\n", "a.csv", "row_px"),
        (_csv().replace("1,0,", "one,0,", 1).encode(), "a.csv", "frame"),
        (b"PAR1 and nothing more", "a.parquet", "(?i)parquet"),
        (_csv().encode("utf-16"), "a.csv", "UTF-8"),
    ],
)
def test_a_file_that_cannot_be_read_stores_nothing(engine, people, blobs, file, content, file_name, says):
    file.write_bytes(content)
    before = _stored(engine, blobs)
    with pytest.raises(RefusedInputError, match=says):
        _add(engine, people["ana"], blobs, file, file_name)
    assert _stored(engine, blobs) == before


@pytest.mark.parametrize(
    ("name", "changes", "error", "says"),
    [
        ("dee", {}, ForbiddenError, "role analyst"),
        ("ana", {"sensor_id": 99}, NotFoundError, "no sensor 99"),
        ("ana", {"purpose": "decoration"}, RefusedInputError, "calibration or validation"),
    ],
)
def test_an_upload_that_is_not_allowed_stores_nothing(engine, people, blobs, file, name, changes, error, says):
    before = _stored(engine, blobs)
    with pytest.raises(error, match=says):
        _add(engine, people[name], blobs, file, **changes)
    assert _stored(engine, blobs) == before


def test_a_database_that_fails_after_the_bytes_leaves_no_row(engine, people, blobs, file, monkeypatch):
    before = _stored(engine, blobs)

    def break_down(*_: object) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr(audit, "append", break_down)
    with pytest.raises(OSError, match="disk"):
        _add(engine, people["ana"], blobs, file)
    assert _stored(engine, blobs)[1:] == before[1:]


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("C:\\data\\a.csv", "a.csv"),
        ("../../etc/a.csv", "a.csv"),
        ("a.csv", "a.csv"),
        ("..\uff0fcafe\u0301.csv", "caf\u00e9.csv"),
    ],
)
def test_of_the_senders_name_no_folder_is_kept_and_its_normal_form(engine, people, blobs, file, sent, kept):
    assert _add(engine, people["ana"], blobs, file, sent).name == kept


@pytest.mark.parametrize("sent", ["n" * 252 + ".csv", "a\u202evsc.csv", "a\u200b.csv", "a\ud800.csv"])
def test_a_file_name_that_is_long_or_hides_something_stores_nothing(engine, people, blobs, file, sent):
    with pytest.raises(RefusedInputError, match="file name"):
        _add(engine, people["ana"], blobs, file, sent)
    with open_reading(engine) as session:
        assert telemetry_sets.list_telemetry_sets(session) == []


def test_sets_are_listed_by_purpose(engine, people, blobs, file):
    first = _add(engine, people["ana"], blobs, file)
    file.write_text(_csv(frames=4), encoding="utf-8")
    second = _add(engine, people["ana"], blobs, file, purpose="validation")
    with open_reading(engine) as session:
        assert [row.id for row in telemetry_sets.list_telemetry_sets(session, sensor_id=1)] == [second.id, first.id]
        assert [row.id for row in telemetry_sets.list_telemetry_sets(session, purpose="validation")] == [second.id]
        with pytest.raises(NotFoundError, match="telemetry set 99"):
            session.get_known(TelemetrySet, 99)


def test_a_quality_report_is_read_as_it_was_written_and_one_that_says_less_as_far_as_it_goes(
    engine, people, blobs, file
):
    quality = _add(engine, people["ana"], blobs, file).quality
    said = to_plain(parse_quality(quality))
    assert said.pop("diagnosis") is None
    assert {"verdict", "findings", "stars_per_exposure", "detector_coverage", "radial_coverage"} <= said.keys()
    assert said == {name: quality[name] for name in said}
    assert parse_quality({}) == QualityReport()
    with pytest.raises(RefusedInputError, match=r"temperature_c\.largest", check=has_code("damaged-document")):
        parse_quality({"temperature_c": {"smallest": 1.0}})
