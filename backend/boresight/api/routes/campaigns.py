"""Campaigns: one setting over many sensors, launched, followed and stopped as one."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import OnlyAsked, Reading, SeenTag, Who, Writing, require_tag, tag_of, weak
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import campaigns
from boresight.services.actors import Actor
from boresight.services.campaign_places import MOST_SENSORS, Member
from boresight.services.campaign_views import CampaignView, result_of
from boresight.store.sessions import Session

router = APIRouter(prefix="/campaigns", tags=["runs"])

Newest = Literal["newest"]


class CampaignMember(BaseModel):
    """A sensor, and its sets where they are not its newest."""

    model_config = ConfigDict(extra="forbid")
    sensor_id: Id
    telemetry_set_id: Id | Newest = "newest"
    validation_set_id: Id | Newest | None = Field("newest", description="Null leaves the runs without a held-out set.")


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
    preset: str | None = Field(None, description="Key of a preset; `settings` go over its own.")
    settings: schemas.Document = Field(default_factory=dict)
    sensors: list[CampaignMember] | None = Field(
        None, max_length=MOST_SENSORS, description="Left out, every sensor of the fleet."
    )
    validate_only: bool = Field(
        default=False, description="Check everything, change nothing, and say what it would be."
    )

    def members(self) -> list[Member] | None:
        """Return the sensors as the service takes them."""
        return None if self.sensors is None else [Member(**one.model_dump()) for one in self.sensors]


class CampaignCancellation(BaseModel):
    """Why a campaign is stopped."""

    model_config = ConfigDict(extra="forbid")
    reason: str = ""


def _shown(view: CampaignView) -> schemas.Document:
    """Write a campaign with its counts."""
    columns = {name: getattr(view.row, name) for name in schemas.Campaign.model_fields if hasattr(view.row, name)}
    told = {name: getattr(view, name) for name in ("state", "sensors", "ended", "fraction")}
    return schemas.Campaign(**columns, **told, counts=dict(view.counts)).model_dump(mode="json")


def _tag(view: CampaignView) -> str:
    """Return the tag of a campaign; it changes with what people do to it, not with its runs."""
    return tag_of(view.id, view.row.cancelled_utc, view.newest_id)


def _tagged(session: Session, campaign_id: int, status: int = 200, **headers: str) -> Answer:
    """Answer with a campaign; its counts move under one tag, which is weak therefore."""
    view = campaigns.read_campaign(session, campaign_id)
    return Answer(_shown(view), status, {"ETag": weak(_tag(view)), **headers})


@router.get("", name="list_campaigns", summary="List campaigns", response_model=Page[schemas.Campaign])
def list_campaigns(actor: Who, session: Reading, page: Paged) -> Response:  # noqa: ARG001 - whoever is known may read
    """List campaigns with the counts of their runs, newest first."""
    found = campaigns.list_campaigns(session, before_id=page.last_id, limit=page.limit + 1)
    return json_response(page.cut(found, _shown))


@router.post(
    "",
    name="launch_campaign",
    summary="Launch a campaign",
    status_code=202,
    response_model=schemas.Campaign,
    responses={
        **refusals(404),
        200: {"model": schemas.DryRunOfCampaign, "description": "The dry run of `validate_only`."},
    },
)
def launch_campaign(
    order: CampaignLaunch, actor: Who, once: Idempotent, session: Writing, asked: OnlyAsked
) -> Response:
    """Queue a run for every sensor that can have one; the others are listed with the cause. All or nothing in one transaction."""
    dry = asked or order.validate_only

    def act() -> Answer:
        made: Any = campaigns.launch_campaign(
            session, actor, order.label, order.settings, order.members(), preset=order.preset, validate_only=dry
        )
        if isinstance(made, dict):
            return Answer(made)
        return _tagged(session, made.id, 202, Location=f"/api/v1/campaigns/{made.id}")

    once.tried = dry
    return once.answer(session, actor, act)


@router.get(
    "/{campaign_id}",
    name="get_campaign",
    summary="Read a campaign",
    response_model=schemas.Campaign,
    responses=refusals(404),
)
def get_campaign(campaign_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read a campaign: how many of its runs are in each state, and how far it is."""
    return _tagged(session, campaign_id).response()


@router.get(
    "/{campaign_id}/results",
    name="list_campaign_results",
    summary="List what the sensors came to",
    response_model=Page[schemas.CampaignResult],
    responses=refusals(404),
)
def list_campaign_results(
    campaign_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
) -> Response:
    """List the newest run of every sensor with its cause or its figures, in the order of launch."""
    found = campaigns.results(session, campaign_id, after_id=page.last_id or 0, limit=page.limit + 1)
    return json_response(page.cut(found, lambda one: schemas.CampaignResult(**result_of(one)).model_dump(mode="json")))


def _seen(session: Session, campaign_id: int, seen: str) -> None:
    """Refuse a transition by someone who did not see the campaign as it is."""
    require_tag(seen, _tag(campaigns.read_campaign(session, campaign_id)), f"Campaign {campaign_id}")


@router.post(
    "/{campaign_id}:cancel",
    name="cancel_campaign",
    summary="Stop a campaign",
    response_model=schemas.Campaign,
    responses=refusals(404, 409, 412, 428),
)
def cancel_campaign(
    campaign_id: Id,
    actor: Who,
    seen: SeenTag,
    once: Idempotent,
    session: Writing,
    cancellation: CampaignCancellation | None = None,
) -> Response:
    """Stop every run of a campaign that has not ended."""
    reason = cancellation.reason if cancellation else ""

    def act() -> Answer:
        _seen(session, campaign_id, seen)
        campaigns.cancel_campaign(session, actor, campaign_id, reason)
        return _tagged(session, campaign_id)

    return once.answer(session, actor, act)


@router.post(
    "/{campaign_id}:launch-failed",
    name="relaunch_campaign",
    summary="Launch again what failed",
    status_code=202,
    response_model=schemas.Campaign,
    responses=refusals(404, 409, 412, 428),
)
def relaunch_campaign(campaign_id: Id, actor: Who, seen: SeenTag, once: Idempotent, session: Writing) -> Response:
    """Queue new runs for the sensors whose run failed, was lost, or could not be launched."""
    return once.answer(session, actor, lambda: _again(session, actor, campaign_id, seen))


def _again(session: Session, actor: Actor, campaign_id: int, seen: str) -> Answer:
    """Launch the failed again and answer with the campaign."""
    _seen(session, campaign_id, seen)
    campaigns.relaunch_failed(session, actor, campaign_id)
    return _tagged(session, campaign_id, 202)
