"""Errors as `application/problem+json` (RFC 9457): one table from error class to status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

import orjson
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from boresight import errors
from boresight.disks import storage_error
from boresight.platform.audit.security_log import tell_once

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True)
class ProblemKind:
    """How one kind of error is reported over HTTP."""

    status: int
    title: str
    name: str = ""  #: where it is not the title in lower case

    @property
    def address(self) -> str:
        """The `type` of the problem."""
        return "urn:boresight:problem:" + (self.name or self.title.lower().replace(" ", "-"))


KINDS: Mapping[type[Exception], ProblemKind] = {
    errors.RefusedInputError: ProblemKind(422, "Refused input"),
    errors.NotFoundError: ProblemKind(404, "Not found"),
    errors.ConflictError: ProblemKind(409, "Conflict"),
    errors.CorruptFileError: ProblemKind(409, "Corrupt file"),  # not a 5xx: a retry does not help
    errors.StaleError: ProblemKind(412, "Stale"),
    errors.PreconditionRequiredError: ProblemKind(428, "Precondition required"),
    errors.ForbiddenError: ProblemKind(403, "Forbidden"),
    errors.PasswordDueError: ProblemKind(403, "Password change required", "password-to-be-set"),
    errors.FactorEnrolmentDueError: ProblemKind(403, "Second factor required", "second-factor-to-be-enrolled"),
    errors.UnauthenticatedError: ProblemKind(401, "Unauthenticated"),
    errors.SecondFactorError: ProblemKind(401, "Second factor needed"),
    errors.SingleSignOnError: ProblemKind(401, "Single sign-on refused"),
    errors.SessionEndedError: ProblemKind(401, "Log-in ended", "session-ended"),
    errors.TooManyAttemptsError: ProblemKind(429, "Too many attempts"),
    errors.TooLargeError: ProblemKind(413, "Too large"),
    errors.OverloadedError: ProblemKind(503, "Overloaded"),
    errors.UnavailableError: ProblemKind(503, "Unavailable"),
    errors.StorageError: ProblemKind(503, "Storage unavailable"),
    errors.CancelledError: ProblemKind(409, "Cancelled"),
}
UNFORESEEN = ProblemKind(500, "Unexpected error", "unforeseen-error")
UNKNOWN_ADDRESS = "There is nothing at this address; see /api/v1/openapi.json."


@dataclass(frozen=True)
class Problem:
    """A refusal, to be sent as JSON or as a page."""

    kind: ProblemKind
    detail: str
    errors: Sequence[Mapping[str, Any]] = ()
    headers: Mapping[str, str] | None = None
    code: str = ""

    @property
    def status(self) -> int:
        """The HTTP status."""
        return self.kind.status


def make_problem(error: Exception) -> Problem:
    """Make the problem of an exception; the message of one that is not a refusal goes to the server's log only."""
    if isinstance(error, RequestValidationError):
        return _malformed(error)
    if isinstance(error, HTTPException):
        detail = UNKNOWN_ADDRESS if error.detail == HTTPStatus.NOT_FOUND.phrase else str(error.detail)
        return Problem(_find_kind(error.status_code), detail, headers=error.headers)
    if isinstance(error, OSError) and (of_disk := storage_error(error)) is not None:
        error = of_disk
    if isinstance(error, errors.ForbiddenError):
        tell_once("authz_fail", "failure", sentence=str(error))
    for kind in type(error).__mro__:
        if kind in KINDS:
            return Problem(KINDS[kind], str(error), _faults(error), _headers(error), getattr(error, "code", ""))
    return Problem(UNFORESEEN, "The server failed unexpectedly; report the request id with what you did.")


def _find_kind(status: int) -> ProblemKind:
    """Return the kind for a status of the framework: unknown address, wrong method, unreadable body."""
    return next(
        (kind for kind in KINDS.values() if kind.status == status), ProblemKind(status, HTTPStatus(status).phrase)
    )


def _malformed(error: RequestValidationError) -> Problem:
    """Make the problem of an invalid request, with a JSON pointer to each wrong member."""
    places = [
        {
            "pointer": "".join(f"/{part}" for part in found["loc"][1:]),
            "where": str(found["loc"][0]) if found["loc"] else "body",
            "row": None,
            "column": None,
            "detail": str(found["msg"]),
        }
        for found in error.errors()
    ]
    first = places[0] if places else {"pointer": "", "where": "body", "detail": "it cannot be read"}
    place = first["pointer"] or first["where"]
    return Problem(
        ProblemKind(422, "Malformed request"),
        f"The request has an invalid or missing value at {place}: {_lower(str(first['detail']))}. Correct it and send it again.",
        places,
    )


def _lower(detail: str) -> str:
    """Write what the framework finds wrong as the rest of a sentence."""
    said = detail.replace("Input should", "it should", 1).replace("Field required", "it is required", 1)
    return said[:1].lower() + said[1:]


def _faults(error: Exception) -> list[dict[str, Any]]:
    faults = getattr(error, "faults", ())
    return [{"row": fault.row, "column": fault.column, "detail": fault.detail} for fault in faults]


def _headers(error: Exception) -> dict[str, str] | None:
    """Return `WWW-Authenticate` and `Retry-After` where they apply."""
    if isinstance(error, errors.TooManyAttemptsError | errors.OverloadedError | errors.StorageError):
        return {"Retry-After": str(error.wait_s)}
    return {"WWW-Authenticate": "Bearer"} if isinstance(error, errors.UnauthenticatedError) else None


def problem_response(request: Request, problem: Problem) -> Response:
    """Write a problem as the answer to a request."""
    body = {
        "type": problem.kind.address,
        "title": problem.kind.title,
        "status": problem.status,
        "code": problem.code or None,
        "detail": problem.detail,
        "instance": request.url.path,
        "request_id": getattr(request.state, "request_id", None),
        "errors": list(problem.errors),
    }
    return Response(orjson.dumps(body), problem.status, problem.headers, MEDIA_TYPE)
