"""Every table, one noun a file. SQLite (STRICT) by default, PostgreSQL by URL, the same definitions and migrations for both."""

from __future__ import annotations

from boresight.store.tables.alarms import (
    ALARM_EVENTS,
    ALARM_KINDS,
    ALARM_LEVELS,
    NOTE_SUBJECTS,
    Alarm,
    AlarmEvent,
    Note,
)
from boresight.store.tables.approvals import APPROVAL_KINDS, APPROVAL_STATES, Approval, Opening, Remark, Signature
from boresight.store.tables.campaigns import Campaign, CampaignRun, Preset
from boresight.store.tables.declared import Base
from boresight.store.tables.fleet import Blob, Sensor, TelemetrySet
from boresight.store.tables.gates import GateProfile, GateReport, Waiver
from boresight.store.tables.parameter_sets import GROUND_STATES, ONBOARD_STATES, ParameterSet, Promotion
from boresight.store.tables.people import ROLES, SESSION_ENDINGS, ApiKey, LoginSession, User
from boresight.store.tables.proposals import PROPOSAL_KINDS, PROPOSAL_STATES, ChangeProposal
from boresight.store.tables.records import AuditRecord, IdempotentResponse
from boresight.store.tables.runs import RUN_STATES, TERMINAL_RUN_STATES, Run, RunEvent
from boresight.store.tables.uplinks import Package, TableDefinition, Uplink
from boresight.store.tables.webhooks import DELIVERY_STATES, Webhook, WebhookDelivery

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
