"""The one route class of the API.

An operation reads its request, calls one service, and returns the row; this class gives

- who acts: only known actors get in, unless the router is `open_to_all`; unsafe requests repeat the CSRF token;
- the answer in the shape of `response_model`, with the `ETag` and the `Location` that the shape declares;
- idempotency of every POST that writes: with `Idempotency-Key` the answer is stored for a day under (key, actor), in
  the transaction of the effect, with the SHA-256 of the request; another request under the same key is refused;
- dry runs: with `validate_only` the transaction is a trial, and the answer says so;
- the refusals that its dependencies can make, in the documentation (`boresight.platform.web.openapi.refuses`).
"""

from __future__ import annotations

import functools
import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Depends, Header, Security
from fastapi.datastructures import DefaultPlaceholder
from fastapi.security import APIKeyCookie, HTTPBearer
from pydantic import TypeAdapter
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from boresight.console.access.credentials import SESSION_COOKIE, get_actor
from boresight.console.access.dependencies import IsDryRun, Who, Writing, csrf
from boresight.console.schemas import Row
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.audit.queries import find_response, forget_responses
from boresight.platform.audit.tables import IdempotentResponse
from boresight.platform.db.sessions import Engine, Session, open_reading, utc_after, utc_now
from boresight.platform.web.lazy_route import BUILDING, LazyRoute
from boresight.platform.web.openapi import dependency_refusals, refusals

PREFIX = "/api/v1"
KEPT_FOR_S = 24 * 3600.0
LONGEST_KEY = 200
PASSWORDS = ("password", "current", "factor")
NUMBERS = orjson.OPT_SERIALIZE_NUMPY
FORM_CONTENT = "form_content"  # in the request's state: a function that returns the content of its form as bytes
CREDENTIALS = (
    Security(HTTPBearer(scheme_name="ApiKey", description="`bs_...`, from POST /api/v1/api-keys", auto_error=False)),
    Security(APIKeyCookie(name=SESSION_COOKIE, scheme_name="LogInCookie", auto_error=False)),
)


@dataclass(frozen=True)
class OperationResponse:
    """An answer that needs more than a row."""

    body: Any
    status: int | None = None  # other than the route's
    shape: Any = None  # other than the route's
    headers: Mapping[str, str] = field(default_factory=dict)  # besides the shape's
    shown_once: tuple[str, ...] = ()  # members that hold a secret: null in a replay, and in a trial
    is_trial: bool = False  # of a dry run that the body asked for


class RowWithFields:
    """A row with values besides its columns."""

    def __init__(self, row: Any, **more: Any) -> None:
        self._row = row
        self.__dict__.update(more)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._row, name)


def json_response(body: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Write a document as JSON; numbers in full, NaN and infinity as null."""
    content = b"" if status == HTTPStatus.NO_CONTENT else orjson.dumps(body, option=NUMBERS)
    return Response(content, status, headers, "application/json")


@dataclass(frozen=True)
class Written:
    """An answer as it is sent, before it is bytes."""

    body: dict[str, Any]
    status: int
    headers: dict[str, str]
    shown_once: tuple[str, ...] = ()
    is_trial: bool = False

    @property
    def without_secrets(self) -> dict[str, Any]:
        """The body without the members that are shown only once."""
        return self.body | dict.fromkeys(self.shown_once)


@dataclass(frozen=True)
class Idempotency:
    """Who asks, under which key if there is one, the digest of the request, and whether it is a dry run."""

    actor: Actor
    key: str | None
    request_sha256: str
    is_dry_run: bool

    def answer(self, session: Session, act: Callable[[], Written | Response]) -> Response:
        """Perform the operation and store its answer, or return the stored answer."""
        owner = f"{self.actor.name} {self.actor.credential}"
        if self.key is not None:
            forget_responses(session, before_utc=utc_after(-KEPT_FOR_S))
            if (known := find_response(session, self.key, owner)) is not None:
                return self._replay(known)
        made = act()
        if isinstance(made, Response):
            return made
        if self.is_dry_run or made.is_trial:
            return json_response(made.without_secrets, headers={"X-Validate-Only": "true"})
        if self.key is not None:
            session.add(
                IdempotentResponse(
                    key=self.key,
                    actor=owner,
                    request_sha256=self.request_sha256,
                    status=made.status,
                    headers=made.headers,
                    body=made.without_secrets,
                    created_utc=utc_now(),
                )
            )
        return json_response(made.body, made.status, made.headers)

    def is_answered(self, engine: Engine) -> bool:
        """Whether the answer is stored already, for what is done before the transaction."""
        if self.key is None:
            return False
        with open_reading(engine) as session:
            return find_response(session, self.key, f"{self.actor.name} {self.actor.credential}") is not None

    def _replay(self, known: IdempotentResponse) -> Response:
        if known.request_sha256 != self.request_sha256:
            raise RefusedInputError(
                "This Idempotency-Key was used for another request; use a new key for a new request."
            )
        return json_response(known.body, known.status, {**known.headers, "Idempotent-Replayed": "true"})


IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=LONGEST_KEY,
        description="Send the same key again to get the same answer without repeating the effect.",
    ),
]


async def get_idempotency(
    request: Request, actor: Who, asked: IsDryRun, idempotency_key: IdempotencyKey = None
) -> Idempotency:
    """Read the key, and digest the request if there is one."""
    if idempotency_key is None or asked:
        return Idempotency(actor, None, "", asked)
    form = getattr(request.state, FORM_CONTENT, None)
    content, is_dry_run = (await run_in_threadpool(form), False) if form is not None else _read(await request.body())
    if is_dry_run:
        return Idempotency(actor, None, "", is_dry_run=True)
    address = f"{request.method} {request.url.path}?{request.url.query}\n"
    return Idempotency(actor, idempotency_key, hashlib.sha256(address.encode() + content).hexdigest(), asked)


def _read(content: bytes) -> tuple[bytes, bool]:
    """Return a JSON body without its passwords, for what is kept must not help to guess one, and whether it is a dry run."""
    try:
        body = orjson.loads(content)
    except orjson.JSONDecodeError:
        return content, False
    if not isinstance(body, dict):
        return content, False
    return orjson.dumps({name: value for name, value in body.items() if name not in PASSWORDS}), (
        body.get("validate_only") is True
    )


class Operation(LazyRoute):
    """A route of the API."""

    def _build(self, options: dict[str, Any]) -> None:
        shape = options.get("response_model")
        if isinstance(shape, DefaultPlaceholder):
            shape = None
        posts, signature = "POST" in (self.methods or ()), inspect.signature(self.endpoint, eval_str=True)
        writes = next((one.name for one in signature.parameters.values() if one.annotation == Writing), None)
        if shape is not None or (posts and writes):
            writer = _Writer(shape, options.get("status_code") or HTTPStatus.OK)
            self.endpoint = _answered(self.endpoint, signature, writer, writes if posts else None)
        super()._build({**options, "response_model": shape, "operation_id": self.name})
        self.responses = {**dependency_refusals(self.dependant), **self.responses}


class _Writer:
    """Writes what an endpoint returns in the shape of its route."""

    def __init__(self, shape: Any, status: int) -> None:
        self._shape = shape
        self._status = status
        self._adapters: dict[Any, TypeAdapter[Any]] = {}

    def write(self, made: Any) -> Written:
        """Write an answer, with the headers that its shape declares."""
        answer = made if isinstance(made, OperationResponse) else OperationResponse(made)
        shape, status = answer.shape or self._shape, answer.status or self._status
        if shape is None:
            return Written({}, status, dict(answer.headers))
        if shape not in self._adapters:
            with BUILDING:
                self._adapters[shape] = TypeAdapter(shape)
        adapter = self._adapters[shape]
        body = adapter.dump_python(adapter.validate_python(answer.body, from_attributes=True), mode="json")
        headers = shape.headers(answer.body, status) if isinstance(shape, type) and issubclass(shape, Row) else {}
        return Written(body, status, {**headers, **answer.headers}, answer.shown_once, answer.is_trial)


def _answered(
    endpoint: Callable[..., Any], signature: inspect.Signature, writer: _Writer, transaction: str | None
) -> Callable[..., Response]:
    """Wrap an endpoint so that it answers with its row; idempotent where the name of its writing transaction is given."""

    @functools.wraps(endpoint)
    def answered(**given: Any) -> Response:
        asked: Idempotency | None = given.pop("idempotency", None)

        def act() -> Written | Response:
            made = endpoint(**given)
            return made if isinstance(made, Response) else writer.write(made)

        if asked is not None and transaction is not None:
            return asked.answer(given[transaction], act)
        made = act()
        return made if isinstance(made, Response) else json_response(made.body, made.status, made.headers)

    parameters = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in signature.parameters.values()]
    if transaction is not None:  # resolved last, after everything that is checked before the transaction
        key = inspect.Parameter(
            "idempotency", inspect.Parameter.KEYWORD_ONLY, annotation=Annotated[Idempotency, Depends(get_idempotency)]
        )
        parameters.append(key)
    answered.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]  # what the framework reads
    return answered


def operations(prefix: str = "", *, tags: Sequence[str], open_to_all: bool = False) -> APIRouter:
    """Return a router for the operations of a noun, under the version and guarded; with `open_to_all` also for unknown actors."""
    guards = [*CREDENTIALS, Depends(csrf), *(() if open_to_all else (Depends(get_actor),))]
    return APIRouter(
        prefix=PREFIX + prefix,
        tags=list(tags),
        route_class=Operation,
        dependencies=guards,
        responses=refusals(401, 403, 422),
    )
