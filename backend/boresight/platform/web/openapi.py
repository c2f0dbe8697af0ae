"""Additions to the OpenAPI document: rules that apply to all routes, and the schema of refusals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any, TypeVar

from fastapi.dependencies.models import Dependant
from pydantic import BaseModel, Field

from boresight.platform.web.problems import MEDIA_TYPE

DESCRIPTION = """\
Recalibration of star trackers on orbit: every action that the pages offer.

**Who acts.** A person's log-in cookie (`POST /api/v1/sessions`) or an API key, `Authorization: Bearer bs_...`. Unsafe
requests with the cookie repeat the log-in's token in `X-CSRF-Token`. Keys act within their scopes and can never sign.

**Refusals** are `application/problem+json`: `type`, `title`, `status`, `detail` (one sentence that says what to do),
`code` (the reason in a fixed word such as `already-signed`, or null), `instance`, `request_id`, and `errors` with the
places: `row` and `column` of a file, `pointer` of a JSON body.

**Versions.** What can change carries an `ETag`. A transition (`:submit`, `:approve`, ...) needs it in `If-Match`: 428
without, 412 when somebody else changed it first. States change by transitions only.

**Idempotency.** `Idempotency-Key` on a POST: the same request repeated within a day gets the same answer and has no second effect;
another request under that key gets 422.

**Lists** are `{"items": [...], "next": cursor}`; send `next` back as `cursor`, with the same filters. `limit` is 50
unless you say otherwise, 200 at most. Filters are query parameters; repeat `state` for several states.

**Dry runs.** `validate_only=true` makes the same checks and changes nothing.

**Names.** Units are in the names, times are UTC (ISO 8601), an unknown number is null. `X-Request-ID` is
taken from your request or generated, and returned in every answer, problem and audit record. `Boresight-Four-Eyes: off` in an
answer: on this server one person can submit and sign alone, and file names begin with `four-eyes-off-`.
"""

TAGS = [
    {"name": "sensors", "description": "Star trackers: optics, detector, ground calibration."},
    {"name": "telemetry sets", "description": "Uploaded star centroids and their quality reports."},
    {"name": "runs", "description": "Calibrations: launch, follow, cancel, read."},
    {"name": "alignments", "description": "Rotations between two sensors, from a run of each."},
    {"name": "parameter sets", "description": "Camera parameters on their way to a baseline."},
    {"name": "gates", "description": "Limits that parameter sets must meet, gate reports, and waivers."},
    {"name": "approvals", "description": "Requests that a second person signs or refuses."},
    {
        "name": "change proposals",
        "description": "Changes of gate profiles and table definitions that wait for a second person.",
    },
    {"name": "uplinks", "description": "What was sent and loaded on board, as recorded."},
    {"name": "alarms", "description": "What needs a person: acknowledge, shelve, assign, comment."},
    {"name": "ingest", "description": "New telemetry, judged by its sensor's policy; people decide on what it finds."},
    {"name": "notes", "description": "Notes that people wrote; they are never edited or removed."},
    {"name": "events", "description": "The live feed, as server-sent events."},
    {"name": "audit", "description": "The append-only, hash-chained log, and its signed heads."},
    {"name": "backups", "description": "Scheduled backups, and whether each can be restored."},
    {"name": "users", "description": "Users and their roles."},
    {"name": "API keys", "description": "Keys for programs."},
    {"name": "webhooks", "description": "Programs that are notified of events."},
    {"name": "sessions", "description": "Logging in and out."},
    {"name": "second factors", "description": "Your authenticator apps, security keys and recovery codes."},
    {"name": "preferences", "description": "How pages are shown to a person."},
    {
        "name": "messages",
        "description": "The addresses at which a person gets messages, and the events they are sent for.",
    },
    {"name": "saved views", "description": "Pages with their filters and zoom under a name, and favourites."},
    {"name": "server", "description": "Health, readiness, metrics."},
]

JSON = "application/json"
NOTHING = {"type": "object", "title": "Nothing", "additionalProperties": False}
BINARY = {"application/octet-stream", "application/zip"}
FILES = {*BINARY, "text/csv", "text/html"}
ROWS = ("run", "runs", "reference", "compare", "history")  # parameters that name rows, besides all that end in _id
READS_FILES = (
    "/result",
    "/choice",
    "/figure",
    "/source",
    "/camera-file",
    "/report",
    "}",
    "/data",
    "/radial",
    "/frames",
    "/compare",
    "/file",
    "/dump",
    "/content",
)


def _header(description: str, kind: str = "string") -> dict[str, Any]:
    return {"description": description, "schema": {"type": kind}}


HEADERS = {
    "X-Request-ID": _header("Request ID to quote in reports; taken from your request or generated."),
    "ETag": _header("The version: for `If-Match` of a change, and for `If-None-Match` of the next read."),
    "Location": _header("Address of the result."),
    "Retry-After": _header("Seconds to wait, a whole number.", "integer"),
    "WWW-Authenticate": _header("`Bearer`."),
    "Idempotent-Replayed": _header("`true` where this is the answer to an earlier request with the same key."),
    "X-Validate-Only": _header("`true` where nothing was stored."),
    "Content-Disposition": _header("The name of the file."),
}
SENTENCES = {
    400: "This is not an HTTP request, or its body cannot be read.",
    401: "Nobody is logged in, or the key is not valid.",
    403: "This person or key may not do this, or the CSRF token is missing.",
    404: "The resource does not exist.",
    408: "The request did not arrive completely in time.",
    409: "The resource is not in a state that allows this.",
    412: "The resource was changed since you read it.",
    413: "The body is over the size limit.",
    415: "Only text in UTF-8 is read.",
    422: "The input is refused; `errors` says where.",
    428: "`If-Match` is missing.",
    429: "Too many failed attempts; `Retry-After` says how many seconds to wait.",
    431: "The request headers are too large.",
    503: "Too many requests at once, or the store does not respond; `Retry-After` says when to try again.",
}


class FieldError(BaseModel):
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
    code: str | None = Field(
        None, description="The reason in a fixed word, where it has one.", examples=["already-signed"]
    )
    detail: str = Field(examples=["Column row_px is missing; add it or rename the one that contains it."])
    instance: str = Field(examples=["/api/v1/telemetry-sets"])
    request_id: str | None
    errors: list[FieldError]


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


Noted = TypeVar("Noted", bound=Callable[..., Any])


def refuses(*statuses: int) -> Callable[[Noted], Noted]:
    """Declare the refusals of a dependency or operation, besides those that every operation has."""

    def noted(dependency: Noted) -> Noted:
        dependency.refuses = statuses  # type: ignore[attr-defined]  # read by `dependency_refusals`
        return dependency

    return noted


def dependency_refusals(dependant: Dependant) -> dict[int | str, dict[str, Any]]:
    """List the refusals that an operation and its dependencies declare."""
    noted = {status for call in _calls(dependant) for status in getattr(call, "refuses", ())}
    return {status: {**answer, "model": None} for status, answer in refusals(*sorted(noted)).items()}


def _calls(dependant: Dependant) -> Iterator[Any]:
    yield dependant.call
    for one in dependant.dependencies:
        yield from _calls(one)


def corrected(document: dict[str, Any], cookie_name: str) -> dict[str, Any]:
    """Complete an OpenAPI document with rules for all operations of a kind, which the framework does not know."""
    components = document["components"]
    components["headers"] = HEADERS
    for scheme in components.get("securitySchemes", {}).values():
        if scheme.get("in") == "cookie":
            scheme["name"] = cookie_name  # by the settings of the server
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            _describe_dry_run(operation)
            for status in _refused(path, method, operation) if path.startswith("/api/") else ():
                operation["responses"].setdefault(str(status), refusals(status)[status] | {"model": None}).pop(
                    "model", None
                )
            operation["responses"] = dict(sorted(operation["responses"].items()))
            for status, answer in operation["responses"].items():
                _describe_answer(method, operation, status, answer)
    return document


def _parameters(operation: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {parameter["name"]: parameter for parameter in operation.get("parameters", ())}


def _describe_dry_run(operation: dict[str, Any]) -> None:
    """Mark `If-Match` as required and describe the answer to a dry run."""
    named, answers = _parameters(operation), operation["responses"]
    if "If-Match" in named and "428" in answers:
        named["If-Match"] |= {"required": True, "schema": {"type": "string", "title": "If-Match"}}
    if "validate_only" in named and "200" not in answers:
        done = next(answer for status, answer in sorted(answers.items()) if status.startswith("2"))
        trial = {"description": "The dry run of `validate_only`: what the result would be; nothing is stored."}
        answers["200"] = trial | {"content": done.get("content") or {JSON: {"schema": NOTHING}}}


def _refused(path: str, method: str, operation: dict[str, Any]) -> Iterator[int]:
    """Yield the refusals that follow from an operation's inputs."""
    named, has_body = _parameters(operation), "requestBody" in operation
    yield from (400, 401, 403, 408, 422, 431, 503)
    if has_body:
        yield from (413, 415)
    names_rows = any(name in ROWS or name.endswith("_id") for name in named)
    if "{" in path or has_body or names_rows:
        yield 404
    if method != "get" or path.endswith(READS_FILES):
        yield 409
    if "If-Match" in named:
        yield 412


def _describe_answer(method: str, operation: dict[str, Any], status: str, answer: dict[str, Any]) -> None:
    """Describe an answer's headers, and the media type of refusals."""
    content, named = answer.get("content", {}), _parameters(operation)
    if MEDIA_TYPE in content:
        answer["content"] = {MEDIA_TYPE: content[MEDIA_TYPE]}
    for media_type in BINARY & content.keys():
        content[media_type]["schema"] = {"type": "string", "format": "binary"}
    if answer["description"] == "Successful Response":
        answer["description"] = f"{operation['summary']}: done."
    carried = ["X-Request-ID"]
    if status.startswith("2"):
        carried += ["ETag"] * (method in {"get", "put"} or "If-Match" in named)
        carried += ["Location"] * (status in {"201", "202"})
        carried += ["Idempotent-Replayed"] * ("Idempotency-Key" in named)
        carried += ["X-Validate-Only"] * (status == "200" and "validate_only" in named)
        carried += ["Content-Disposition"] * bool(FILES & content.keys())
    carried += ["Retry-After"] * (status in {"429", "503"}) + ["WWW-Authenticate"] * (status == "401")
    answer["headers"] = {name: {"$ref": f"#/components/headers/{name}"} for name in carried} | answer.get("headers", {})
