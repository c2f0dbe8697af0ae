"""Every table, one noun a file. SQLite (STRICT) by default, PostgreSQL by URL, the same definitions and migrations for both."""

from __future__ import annotations

from boresight.console.access.tables import ROLES, SESSION_ENDINGS, ApiKey, LoginSession, User
from boresight.console.alarms.tables import ALARM_EVENTS, ALARM_KINDS, ALARM_LEVELS, Alarm, AlarmEvent
from boresight.console.approvals.tables import (
    APPROVAL_KINDS,
    APPROVAL_STATES,
    PROPOSAL_KINDS,
    PROPOSAL_STATES,
    Approval,
    ChangeProposal,
    GateProfile,
    GateReport,
    Opening,
    Remark,
    Signature,
    Waiver,
)
from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.fleet.tables import Sensor
from boresight.console.notes.tables import NOTE_SUBJECTS, Note
from boresight.console.parameter_sets.tables import GROUND_STATES, ONBOARD_STATES, ParameterSet, Promotion
from boresight.console.runs.tables import RUN_STATES, TERMINAL_RUN_STATES, Preset, Run, RunEvent
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.uplinks.tables import Package, TableDefinition, Uplink
from boresight.console.webhooks.tables import DELIVERY_STATES, Webhook, WebhookDelivery
from boresight.platform.audit.tables import AuditRecord, IdempotentResponse
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.declared import Base

__all__ = [
    "ALARM_EVENTS",
    "ALARM_KINDS",
    "ALARM_LEVELS",
    "APPROVAL_KINDS",
    "APPROVAL_STATES",
    "DELIVERY_STATES",
    "GROUND_STATES",
    "NOTE_SUBJECTS",
    "ONBOARD_STATES",
    "PROPOSAL_KINDS",
    "PROPOSAL_STATES",
    "ROLES",
    "RUN_STATES",
    "SESSION_ENDINGS",
    "TERMINAL_RUN_STATES",
    "Alarm",
    "AlarmEvent",
    "ApiKey",
    "Approval",
    "AuditRecord",
    "Base",
    "Blob",
    "Campaign",
    "CampaignRun",
    "ChangeProposal",
    "GateProfile",
    "GateReport",
    "IdempotentResponse",
    "LoginSession",
    "Note",
    "Opening",
    "Package",
    "ParameterSet",
    "Preset",
    "Promotion",
    "Remark",
    "Run",
    "RunEvent",
    "Sensor",
    "Signature",
    "TableDefinition",
    "TelemetrySet",
    "Uplink",
    "User",
    "Waiver",
    "Webhook",
    "WebhookDelivery",
]
