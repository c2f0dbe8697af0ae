"""A fleet for campaigns: sensors, each with sets that are named and never looked into."""

from collections.abc import Mapping
from typing import Any

from boresight.console.fleet.tables import Sensor
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Session, utc_now

PURPOSES = ("calibration", "validation")


def add_fleet(session: Session, blobs: BlobStore, document: Mapping[str, Any], n: int) -> list[int]:
    now = utc_now()
    added = [Sensor(name=f"ST-{k:04}", document={**document, "name": f"ST-{k:04}"}, created_utc=now) for k in range(n)]
    session.add_all(added)
    session.flush()
    add_sets(session, blobs, [sensor.id for sensor in added])
    audit.append(session, COMMAND_LINE, "brought in", "sensors")
    return [sensor.id for sensor in added]


def add_sets(session: Session, blobs: BlobStore, sensor_ids: list[int], purposes: tuple[str, ...] = PURPOSES) -> None:
    for purpose in purposes:
        content = f"{purpose} {session.query(TelemetrySet).count()}".encode()
        sha256 = register_blob(session, blobs, blobs.put(content), "text/csv").sha256
        session.add_all(
            TelemetrySet(
                sensor_id=sensor_id, name=purpose, purpose=purpose, original_sha256=sha256, table_sha256=sha256, frames=100,
                stars=2000, quality={}, uploaded_utc=utc_now(),
            )
            for sensor_id in sensor_ids
        )  # fmt: skip
        session.flush()
