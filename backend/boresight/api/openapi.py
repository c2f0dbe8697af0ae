"""What the OpenAPI document says besides the routes: the rules that hold for all of them, and the shape of refusals."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from pydantic import BaseModel, Field

from boresight.api.problems import MEDIA_TYPE

DESCRIPTION = """\
Recalibrating star trackers on orbit: every action that the pages have.

**Who acts.** A person's log-in cookie (`POST /api/v1/sessions`) or an API key, `Authorization: Bearer bs_...`. Unsafe
requests with the cookie repeat the log-in's token in `X-CSRF-Token`. Keys act within their scopes and never sign.

**Refusals** are `application/problem+json`: `type`, `title`, `status`, `detail` (one sentence that says what to do),
`instance`, `request_id`, and `errors` with the places: `row` and `column` of a file, `pointer` of a JSON body.

**Versions.** What can change carries an `ETag`. A transition (`:submit`, `:approve`, ...) needs it in `If-Match`: 428
without, 412 when somebody was faster. States change by transitions only.

**Once.** `Idempotency-Key` on a POST: the same request again within a day gets the same answer and has no second effect;
another request under that key gets 422.

**Lists** are `{"items": [...], "next": cursor}`; send `next` back as `cursor`, with the same filters. `limit` is 50
unless you say otherwise, 200 at most. Filters are query parameters; several states are given by repeating `state`.

**Dry runs.** `validate_only=true` makes the same checks and changes nothing.

**Names.** Units are in the names, times are UTC (ISO 8601), a number that cannot be given is null. `X-Request-ID` is
taken over from you or made, and comes back in every answer, problem and audit record. `Boresight-Four-Eyes: off` in an
answer: here one person may submit and sign alone; the names of files begin with `four-eyes-off-` then.
"""

TAGS = [
    {"name": "sensors", "description": "Star trackers: optics, detector, ground calibration."},
    {"name": "telemetry sets", "description": "Uploaded star centroids and their quality reports."},
    {"name": "runs", "description": "Calibrations: launch, follow, stop, read."},
    {"name": "parameter sets", "description": "Camera parameters on their way to a baseline."},
    {"name": "gates", "description": "Limits that parameter sets are held to, what was found, and waivers."},
    {"name": "approvals", "description": "Requests that a second person signs or refuses."},
    {"name": "uplinks", "description": "What was sent and loaded on board, as recorded."},
    {"name": "alarms", "description": "What needs a person: acknowledge, shelve, assign, comment."},
    {"name": "notes", "description": "What people wrote down; only ever added."},
    {"name": "events", "description": "The live feed, as server-sent events."},
    {"name": "audit", "description": "The append-only, hash-chained log."},
    {"name": "users", "description": "People and their roles."},
    {"name": "API keys", "description": "Keys for programs."},
    {"name": "webhooks", "description": "Programs that are told what happens."},
    {"name": "sessions", "description": "Logging in and out."},
    {"name": "server", "description": "Health, readiness, metrics."},
]

SENTENCES = {
    400: "The request cannot be read.",
    401: "Nobody is logged in, or the key is not valid.",
    403: "This person or key may not do this, or the CSRF token is missing.",
    404: "There is no such thing.",
    409: "It is not in a state that allows this.",
    412: "Somebody changed it since you read it.",
    413: "The upload is over the size limit.",
    422: "The input is refused; `errors` says where.",
    428: "`If-Match` is missing.",
    429: "Too many wrong passwords; `Retry-After` says how many seconds to wait.",
    503: "Not ready yet.",
}


class Place(BaseModel):
    """One place in the input where something is wrong."""

    row: int | None = Field(None, description="Line in the file; the header is line 1.")
    column: str | None = Field(None, description="Column of the file.")
    pointer: str | None = Field(None, description="JSON pointer into the request's body.")
    where: str | None = Field(None, description="`body`, `query`, `path` or `header`.")
    detail: str = Field(description="What is wrong and what to do.")


class ProblemDocument(BaseModel):
    """A refusal (RFC 9457)."""

    type: str = Field(examples=["urn:boresight:problem:refused-input"])
    title: str = Field(examples=["Refused input"])
    status: int = Field(examples=[422])
    detail: str = Field(examples=["Column row_px is missing; add it or rename the one that holds it."])
    instance: str = Field(examples=["/api/v1/telemetry-sets"])
    request_id: str | None
    errors: list[Place]


def refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """List the refusals of a route, each as a problem."""
    return {
        status: {
            "model": ProblemDocument,
            "description": f"{HTTPStatus(status).phrase}. {SENTENCES[status]}",
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}},
        }
        for status in statuses
    }


def corrected(document: dict[str, Any], cookie_name: str) -> dict[str, Any]:
    """Say in an OpenAPI document what the framework cannot know: refusals are problems only, and what success means."""
    for scheme in document["components"].get("securitySchemes", {}).values():
        if scheme.get("in") == "cookie":
            scheme["name"] = cookie_name  # by the settings of the server
    for methods in document["paths"].values():
        for operation in methods.values():
            _describe_headers_and_trials(operation)
            for answer in operation["responses"].values():
                if MEDIA_TYPE in answer.get("content", {}):
                    answer["content"] = {MEDIA_TYPE: answer["content"][MEDIA_TYPE]}
                if answer["description"] == "Successful Response":
                    answer["description"] = f"{operation['summary']}: done."
    return document


def _describe_headers_and_trials(operation: dict[str, Any]) -> None:
    """Say that `If-Match` must be there, which the framework leaves to the 428, and what a trial answers."""
    named = {parameter["name"]: parameter for parameter in operation.get("parameters", ())}
    if "If-Match" in named:
        named["If-Match"] |= {"required": True, "schema": {"type": "string", "title": "If-Match"}}
    if "validate_only" in named and "200" not in operation["responses"]:
        trial = {"description": "The trial of `validate_only`: what would be, and nothing kept."}
        operation["responses"]["200"] = trial
