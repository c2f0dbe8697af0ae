"""The shapes of answers, as the OpenAPI document shows them: a row of the store as JSON, one noun a file.

A list and a single item show the same members. Times are ISO 8601 in UTC. Large documents (a calibration, a figure) have
addresses of their own.
"""

from __future__ import annotations

from boresight.api.schemas.alarms import Alarm, AlarmEvent, Note
from boresight.api.schemas.approvals import Approval, Opening, Remark, Signature, Signer
from boresight.api.schemas.audit import AuditRecord, ChainReport
from boresight.api.schemas.campaigns import Campaign, CampaignResult, DryRunOfCampaign, Preset
from boresight.api.schemas.documents import (
    Calibration,
    Comparison,
    Conversion,
    FigureEntry,
    Health,
    PlotlyFigure,
    Readiness,
    SensorAt,
    Trend,
)
from boresight.api.schemas.fleet import Sensor, TelemetrySet
from boresight.api.schemas.frames import FrameLine, RunFrame
from boresight.api.schemas.gates import DryRunOfProfile, GateProfile, GateReport, TriedProfile, Waiver
from boresight.api.schemas.packages import Package, TableDefinition
from boresight.api.schemas.parameter_sets import ParameterSet
from boresight.api.schemas.people import ApiKey, EndedSessions, LoginSession, NewApiKey, Session, User
from boresight.api.schemas.proposals import ChangeProposal, Difference, ProposedChange
from boresight.api.schemas.row import Document, Row, Settings
from boresight.api.schemas.runs import DryRun, Forecast, LogLine, Run, RunProgress, RunState
from boresight.api.schemas.uplinks import AsOf, Event, OnBoard, Promotion, Uplink, Version
from boresight.api.schemas.webhooks import NewWebhook, Webhook, WebhookDelivery

__all__ = [
    "Alarm",
    "AlarmEvent",
    "ApiKey",
    "Approval",
    "AsOf",
    "AuditRecord",
    "Calibration",
    "Campaign",
    "CampaignResult",
    "ChainReport",
    "ChangeProposal",
    "Comparison",
    "Conversion",
    "Difference",
    "Document",
    "DryRun",
    "DryRunOfCampaign",
    "DryRunOfProfile",
    "EndedSessions",
    "Event",
    "FigureEntry",
    "Forecast",
    "FrameLine",
    "GateProfile",
    "GateReport",
    "Health",
    "LogLine",
    "LoginSession",
    "NewApiKey",
    "NewWebhook",
    "Note",
    "OnBoard",
    "Opening",
    "Package",
    "ParameterSet",
    "PlotlyFigure",
    "Preset",
    "Promotion",
    "ProposedChange",
    "Readiness",
    "Remark",
    "Row",
    "Run",
    "RunFrame",
    "RunProgress",
    "RunState",
    "Sensor",
    "SensorAt",
    "Session",
    "Settings",
    "Signature",
    "Signer",
    "TableDefinition",
    "TelemetrySet",
    "Trend",
    "TriedProfile",
    "Uplink",
    "User",
    "Version",
    "Waiver",
    "Webhook",
    "WebhookDelivery",
]
