"""Campaigns: one setting over many sensors, launched, followed and stopped as one."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from boresight.console import schemas as console_schemas
from boresight.console.access.dependencies import EntityTag, IsDryRun, Reading, SeenTag, Who, Writing
from boresight.console.campaigns import service as campaigns
from boresight.console.campaigns.queries import MemberStatus
from boresight.console.campaigns.service import MOST_SENSORS, CampaignView, MemberRequest, make_result_line
from boresight.console.operation import OperationResponse, RowWithFields, operations
from boresight.console.schemas import Document, Row, Shape
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import Id, Listing, Page, Paged


class Campaign(Row):
    """The same settings for many sensors."""

    versioned_by = ("id", "cancelled_utc", "newest_id")
    moves_beneath = True  # its counts change without its tag
    location = "/campaigns/{row.id}"

    id: int
    label: str
    preset: str | None
    settings: Document
    launched_utc: str
    launched_by: int | None
    cancelled_utc: str | None
    state: str = Field(
        description="`UNDER WAY`, `CANCELLING`, `CANCELLED`, `SUCCEEDED`, or `ENDED` if any run did not succeed."
    )
    sensors: int
    ended: int = Field(description="Sensors whose run has ended or was not launched.")
    fraction: float = Field(description="0 to 1.")
    counts: dict[str, int] = Field(description="Sensors by the state of their run, or `NOT LAUNCHED`.")


class CampaignResult(Row):
    """The result of one sensor of a campaign; values that its run lacks are null."""

    id: int
    sensor_id: int
    sensor: str
    run_id: int | None
    state: str = Field(description="State of the run, or `NOT LAUNCHED`.")
    reason: str | None = Field(description="Why it failed, was lost, was cancelled, or could not be launched.")
    rms_initial_arc_rad: float | None
    rms_final_arc_rad: float | None
    validation_rms_initial_arc_rad: float | None
    validation_rms_final_arc_rad: float | None
    status: str | None
    level: str | None = Field(description="The verdict: normal, caution, serious or critical.")
    weak_directions: int | None
    weakest: str | None
    advice: str | None
    advice_code: str | None = Field(description="The kind of the advice, for its section in the guide.")


class RefusedMember(BaseModel):
    """A sensor that could not have a run, and why."""

    sensor_id: int
    sensor: str
    refusal: str


class DryRunOfCampaign(BaseModel):
    """What a campaign would be, from `validate_only=true`."""

    label: str
    preset: str | None
    settings: Document
    sensors: int
    runs: int
    predicted_s: float = Field(description="Computing time of all runs together, seconds.")
    refused: list[RefusedMember]


router = operations("/campaigns", tags=["runs"])

Newest = Literal["newest"]


class CampaignMember(Shape):
    """A sensor, and its sets where they are not its newest."""

    sensor_id: Id
    telemetry_set_id: Id | Newest = "newest"
    validation_set_id: Id | Newest | None = Field(
        "newest", description="Null leaves the runs without a validation set."
    )


class CampaignLaunch(BaseModel):
    """One setting, and the sensors it is launched over."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"label": "After the eclipse season", "preset": "drift-tracking", "sensors": [{"sensor_id": 1}]}
            ]
        },
    )
    label: str
    preset: str | None = Field(None, description="Key of a preset; `settings` override its own.")
    settings: console_schemas.Settings = Field(default_factory=dict)
    sensors: list[CampaignMember] | None = Field(
        None, max_length=MOST_SENSORS, description="Every sensor of the fleet if omitted."
    )
    validate_only: bool = Field(default=False, description="Validate only, without changes, and describe the result.")

    def members(self) -> list[MemberRequest] | None:
        """Return the sensors as the service takes them."""
        return None if self.sensors is None else [MemberRequest(**one.model_dump()) for one in self.sensors]


class CampaignCancellation(Shape):
    """Why a campaign is stopped."""

    reason: str = ""


def make_row(view: CampaignView) -> RowWithFields:
    """Return a campaign with the counts of its runs."""
    told = {name: getattr(view, name) for name in ("state", "sensors", "ended", "fraction", "counts", "newest_id")}
    return RowWithFields(view.row, **told)


def _require_seen(session: Session, campaign_id: int, seen: EntityTag) -> None:
    seen.require(Campaign, make_row(campaigns.read_campaign(session, campaign_id)), f"Campaign {campaign_id}")


@router.get("", summary="List campaigns", response_model=Page[Campaign])
def list_campaigns(session: Reading, page: Paged) -> Listing[CampaignView]:
    """List campaigns with the counts of their runs, newest first."""
    return page.cut(campaigns.list_campaigns(session, **page.rows), make_row)


@router.post(
    "",
    summary="Launch a campaign",
    status_code=202,
    response_model=Campaign,
    responses={200: {"model": DryRunOfCampaign, "description": "The dry run of `validate_only`."}},
)
def launch_campaign(
    launch: CampaignLaunch, actor: Who, session: Writing, asked: IsDryRun
) -> RowWithFields | OperationResponse:
    """Queue a run for every sensor that can have one; the others are listed with the cause. All or nothing in one transaction."""
    made = campaigns.launch_campaign(
        session,
        actor,
        launch.label,
        launch.settings,
        launch.members(),
        preset=launch.preset,
        validate_only=asked or launch.validate_only,
    )
    if isinstance(made, dict):
        return OperationResponse(made, shape=DryRunOfCampaign, is_trial=True)
    return make_row(campaigns.read_campaign(session, made.id))


@router.get("/{campaign_id}", summary="Read a campaign", response_model=Campaign)
def get_campaign(campaign_id: Id, session: Reading) -> RowWithFields:
    """Read a campaign: how many of its runs are in each state, and how far it is."""
    return make_row(campaigns.read_campaign(session, campaign_id))


@router.get("/{campaign_id}/results", summary="List the results", response_model=Page[CampaignResult])
def list_campaign_results(campaign_id: Id, session: Reading, page: Paged) -> Listing[MemberStatus]:
    """List the newest run of every sensor with its result or its cause of failure, in the order of launch."""
    found = campaigns.list_results(session, campaign_id, **page.rows)
    return page.cut(found, make_result_line)


@router.post("/{campaign_id}:cancel", summary="Cancel a campaign", response_model=Campaign)
def cancel_campaign(
    campaign_id: Id,
    actor: Who,
    seen: SeenTag,
    session: Writing,
    cancellation: CampaignCancellation | None = None,
) -> RowWithFields:
    """Cancel every run of a campaign that has not ended."""
    _require_seen(session, campaign_id, seen)
    campaigns.cancel_campaign(session, actor, campaign_id, cancellation.reason if cancellation else "")
    return make_row(campaigns.read_campaign(session, campaign_id))


@router.post(
    "/{campaign_id}:launch-failed",
    summary="Relaunch failed runs",
    status_code=202,
    response_model=Campaign,
)
def relaunch_campaign(campaign_id: Id, actor: Who, seen: SeenTag, session: Writing) -> RowWithFields:
    """Queue new runs for the sensors whose run failed, was lost, or could not be launched."""
    _require_seen(session, campaign_id, seen)
    campaigns.relaunch_failed(session, actor, campaign_id)
    return make_row(campaigns.read_campaign(session, campaign_id))
