"""One row of nearly every table, for the tests of the schema: what is referred to comes first."""

from typing import Any

from boresight.console.access.tables import User
from boresight.console.alarms.tables import Alarm, AlarmEvent
from boresight.console.alignments.tables import Alignment
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.notes.tables import Note
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.runs.tables import Preset, Run
from boresight.console.telemetry.tables import ImportProfile
from boresight.console.telemetry.tables import TelemetrySet as TelemetrySetRow
from boresight.console.uplinks.tables import Uplink
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.tables import Blob as BlobRow

NOW = "2026-11-21T00:00:00.000000Z"


def parameter_set(number: int, ground_state: str) -> ParameterSet:
    return ParameterSet(
        name=f"PS-ST1-{number}",
        sensor_id=1,
        number=number,
        sha256="5" * 64,
        document={"f_m": 0.016},
        ground_state=ground_state,
        created_utc=NOW,
    )


def alarm() -> Alarm:
    return Alarm(
        source="sensors/1/AGE", sensor_id=1, kind="AGE", level="caution", sentence="s", evidence={}, raised_utc=NOW
    )


def rows_of_tables() -> list[Any]:
    blob = BlobRow(sha256="b" * 64, size_bytes=3_000_000_000, media_type="text/csv", created_utc=NOW)
    telemetry = TelemetrySetRow(
        sensor_id=1,
        name="a.csv",
        purpose="calibration",
        original_sha256="b" * 64,
        table_sha256="b" * 64,
        frames=2,
        stars=20,
        quality={"frames": 2},
        uploaded_utc=NOW,
    )
    run = Run(
        sensor_id=1,
        telemetry_set_id=1,
        method="batch",
        settings={},
        sensor_document={},
        state="SUCCEEDED",
        launched_utc=NOW,
        result_sha256="b" * 64,
    )
    record = AuditRecord(
        at_utc=NOW, actor="Ana", credential="session", action="x", object="y", previous_hash="0", hash="1"
    )
    return [
        User(name="ana", printed_name="Ana", password_hash="x", roles=["analyst"], created_utc=NOW),
        Sensor(name="ST1", document={"name": "ST1", "f_m": 1e22}, created_utc=NOW, created_by=1),
        blob,
        telemetry,
        run,
        Alignment(sensor_a_id=1, sensor_b_id=1, run_a_id=1, run_b_id=1, options={}, created_utc=NOW, state="SUCCEEDED"),
        parameter_set(0, "BASELINE"),
        Approval(parameter_set_id=1, state="OPEN", reason="r", submitted_utc=NOW, submitted_by=1, bound={}),
        Signature(
            approval_id=1,
            user_id=1,
            printed_name="Ana",
            decision="APPROVE",
            meaning="m",
            comment="",
            shown_sha256="s",
            signed_utc=NOW,
        ),
        Uplink(parameter_set_id=1, onboard_state="SENT", source="pass 1", recorded_utc=NOW, recorded_by=1),
        Promotion(sensor_id=1, parameter_set_id=1, at_utc=NOW),
        alarm(),
        AlarmEvent(alarm_id=1, event="RAISED", printed_name="Boresight", text="", at_utc=NOW),
        Note(subject_kind="runs", subject_id=1, user_id=1, printed_name="Ana", text="n", made_utc=NOW),
        ImportProfile(name="ours", number=1, document={}, sha256="c" * 64, created_utc=NOW),
        Preset(name="Ours", number=1, sentence="s", document={}, created_utc=NOW),
        Campaign(label="c", settings={}, launched_utc=NOW),
        CampaignRun(campaign_id=1, sensor_id=1, run_id=1),
        ChangeProposal(
            sensor_id=1,
            kind="gate-profile",
            base_number=0,
            document={},
            sha256="s",
            reason="r",
            proposed_utc=NOW,
            proposed_by=1,
            expires_utc=NOW,
            state="OPEN",
        ),
        record,
    ]
