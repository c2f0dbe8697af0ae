"""The whole way on PostgreSQL: what the services promise on SQLite holds there with the same code."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boresight.console import transitions
from boresight.console.access import users
from boresight.console.approvals import service as approvals
from boresight.console.fleet import service as sensors
from boresight.console.fleet import timeline
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.read_backs import get_sent_table, read_back
from boresight.errors import StaleError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.documents import canonical
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.uplink.table_definition import plain_definition
from tests.passwords import add_person, approve, proved

PASSWORD = "correct horse battery"
PEOPLE: Mapping[str, tuple[str, ...]] = {"ana": ("analyst",), "cy": ("approver",), "dee": ("operator",)}
NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
INITIAL = dict(zip(NAMES, (0.016, 971.5, 1295.5, 0.0, 0.0, 0.0, 0.0, 1.0), strict=True))
SPREAD = dict(zip(NAMES, (5e-5, 50.0, 50.0, 1e6, 50.0, 0.01, 0.01, 0.001), strict=True))
SENSOR: dict[str, Any] = {
    "name": "ST16-1",
    "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6},
    "camera_model": "inverted_wang",
    "parity": 1,
    "centroid_sigma_px": 0.1,
    "initial": INITIAL,
    "typical_sigma": SPREAD,
}
CSV = "frame,exposure,row_px,col_px,ra_deg,dec_deg\n" + "".join(f"1,0,{n}.5,{n * n}.0,{n}.0,1.0\n" for n in range(5))


@pytest.fixture
def people(postgresql: Engine) -> Mapping[str, Actor]:
    with open_writing(postgresql) as session:
        rows = {name: add_person(session, name, *roles) for name, roles in PEOPLE.items()}
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)
        return {name: users.get_actor(session, row.id) for name, row in rows.items()}


def _candidate(engine: Engine, ana: Actor, blobs: BlobStore, folder: Path, f_m: float) -> ParameterSet:
    (folder / "a.csv").write_text(CSV, encoding="utf-8")
    names = list(NAMES)
    result = {
        "schema": "boresight.calibration/1",
        "sensor": SENSOR["name"],
        "method": "batch",
        "camera_model": "inverted_wang",
        "rms_arc_rad": {"initial": 1e-4, "final": 1e-5},
        "parameters": INITIAL | {"f_m": f_m},
        "sigma": SPREAD,
        "covariance": {"names": names, "matrix": np.diag([SPREAD[name] ** 2 for name in names]).tolist()},
        "status": "converged",
    }
    with open_writing(engine) as session:
        telemetry = telemetry_sets.add_telemetry_set(session, ana, blobs, None, 1, folder / "a.csv", "a.csv")
        sha256 = blobs.put(canonical(result).encode())
        telemetry_sets.register_blob(session, blobs, sha256, "application/json")
        run = Run(
            sensor_id=1,
            telemetry_set_id=telemetry.id,
            method="batch",
            settings={},
            sensor_document=SENSOR,
            state="SUCCEEDED",
            launched_utc=telemetry.uploaded_utc,
            launched_by=ana.user_id,
            result_sha256=sha256,
        )
        session.add(run)
        session.flush()
        return parameter_sets.create_from_run(session, ana, blobs, run.id)


def _approve(engine: Engine, people: Mapping[str, Actor], row: ParameterSet, blobs: BlobStore) -> int:
    with open_writing(engine) as session:
        approval = approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
        approve(session, people["cy"], approval)
        return transitions.get_parameter_set(session, row.id).version


def test_promotions_at_once_leave_one_baseline_and_one_chain(
    postgresql: Engine, people: Mapping[str, Actor], tmp_path: Path
) -> None:
    blobs = FolderBlobStore(tmp_path / "blobs")
    rows = [_candidate(postgresql, people["ana"], blobs, tmp_path, 0.016 + n * 1e-6) for n in range(3)]
    versions = [_approve(postgresql, people, row, blobs) for row in rows]

    def promote(number: int) -> str:
        try:
            with open_writing(postgresql) as session:
                return approvals.promote(session, people["dee"], rows[number].id, versions[number]).name
        except StaleError:
            return "stale"

    with ThreadPoolExecutor(3) as pool:
        outcomes = sorted(pool.map(promote, range(3)))
    assert outcomes[1:] == ["stale", "stale"]
    with open_reading(postgresql) as session:
        listed = parameter_sets.list_parameter_sets(session)
        assert [row.name for row in listed if row.ground_state == "BASELINE"] == outcomes[:1]
        assert audit.verify(session).ok


def test_the_ladder_and_the_question_of_when_work(
    postgresql: Engine, people: Mapping[str, Actor], tmp_path: Path
) -> None:
    dee, blobs, plain = people["dee"], FolderBlobStore(tmp_path / "blobs"), plain_definition("inverted_wang")
    with open_writing(postgresql) as session:
        table_definitions.set_definition(session, people["ana"], 1, plain, "As flown.", 0)
        for state in ("SENT", "LOADED"):
            uplinks.record(session, dee, 1, state, "pass 4711")
        seen = session.get_one(ParameterSet, 1)
        sent = get_sent_table(session, blobs, seen).content
        read_back(session, dee, blobs, 1, sent, "pass 4711", seen.version)
        uplinks.activate(session, dee, 1, "pass 4711", "I saw it.", proved(session, dee, PASSWORD), seen.version)
    with open_reading(postgresql) as session:
        assert uplinks.baseline_at(session, 1, "2000-01-01") is None
        assert [row.name for row, _ in uplinks.onboard_at(session, 1, "2100-01-01")] == ["PS-ST16-1-0"]
        assert (
            timeline.get_state_at(session, 1).sentence == "baseline PS-ST16-1-0, on board PS-ST16-1-0 ACTIVE: the same"
        )
        listed = timeline.events(session, 1)
        assert [event.state for event in listed] == ["ACTIVE", "VERIFIED", "LOADED", "SENT", None, "BASELINE"]
        assert timeline.events(session, 1, before_id=listed[1].id, limit=2) == listed[2:4]
        tile = sensors.list_fleet_tiles(session)[0]
    assert (tile.status, tile.active is not None) == ("off", True)
