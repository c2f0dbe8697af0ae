"""The console: one folder per noun. Every table is declared here, because seals, migrations and foreign keys need all of them."""

from boresight.console.access import tables as access_tables
from boresight.console.alarms import tables as alarm_tables
from boresight.console.alignments import tables as alignment_tables
from boresight.console.approvals import tables as approval_tables
from boresight.console.backups import tables as backup_tables
from boresight.console.campaigns import tables as campaign_tables
from boresight.console.change_proposals import tables as change_proposal_tables
from boresight.console.fleet import tables as fleet_tables
from boresight.console.ingest import tables as ingest_tables
from boresight.console.messages import tables as message_tables
from boresight.console.mission_control import tables as mission_control_tables
from boresight.console.notes import tables as note_tables
from boresight.console.parameter_sets import tables as parameter_set_tables
from boresight.console.runs import tables as run_tables
from boresight.console.saved_views import tables as saved_view_tables
from boresight.console.telemetry import tables as telemetry_tables
from boresight.console.uplinks import tables as uplink_tables
from boresight.console.webhooks import tables as webhook_tables
from boresight.platform.audit import tables as audit_tables
from boresight.platform.blobs import tables as blob_tables

TABLES = (
    access_tables,
    alarm_tables,
    alignment_tables,
    approval_tables,
    audit_tables,
    backup_tables,
    blob_tables,
    campaign_tables,
    change_proposal_tables,
    fleet_tables,
    ingest_tables,
    message_tables,
    mission_control_tables,
    note_tables,
    parameter_set_tables,
    run_tables,
    saved_view_tables,
    telemetry_tables,
    uplink_tables,
    webhook_tables,
)
