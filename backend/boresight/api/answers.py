"""What a POST answers, and doing it once however often it is sent.

With `Idempotency-Key` the answer is stored under (key, actor) in the transaction of the effect, together with the SHA-256
of the request: method, address and body. The same request again within a day is answered from the store, with
`Idempotent-Replayed: true`; another request under the same key is refused. A refusal is not stored, for it had no effect.
What is older than a day is deleted in the transaction that stores a new answer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Annotated, Any

import orjson
from fastapi import Depends, Header
from starlette.requests import Request
from starlette.responses import Response

from boresight.api.dependencies import OnlyAsked
from boresight.errors import RefusedInputError
from boresight.services.actors import Actor
from boresight.store.idempotent_responses import forget_responses, response_under
from boresight.store.sessions import Session, utc_after, utc_now
from boresight.store.tables import IdempotentResponse

KEPT_FOR_S = 24 * 3600.0
LONGEST_KEY = 200
PASSWORDS = ("password", "current")
NUMBERS = orjson.OPT_SERIALIZE_NUMPY


@dataclass(frozen=True)
class Answer:
    """A JSON answer; `kept` is what a replay shows instead, where the body holds a secret that is shown once."""

    body: Mapping[str, Any]
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    kept: Mapping[str, Any] | None = None

    def response(self) -> Response:
        """Write the answer."""
        return json_response(self.body, self.status, self.headers)


def json_response(body: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Write a document as JSON; numbers in full, NaN and infinity as null."""
    content = b"" if status == HTTPStatus.NO_CONTENT else orjson.dumps(body, option=NUMBERS)
    return Response(content, status, headers, "application/json")


@dataclass
class Once:
    """The idempotency of one request: its key, if it has one, and its digest."""

    key: str | None
    request_sha256: str
    tried: bool = False

    def answer(self, session: Session, actor: Actor, act: Callable[[], Answer]) -> Response:
        """Act and remember the answer, or give the answer that was remembered.

        Raises
        ------
        RefusedInputError
            When the key was used for another request.
        """
        if self.tried:
            shown = act()
            body = shown.body if shown.kept is None else shown.kept
            return json_response(body, headers={"X-Validate-Only": "true"})
        if self.key is None:
            return act().response()
        owner = f"{actor.name} {actor.credential}"
        forget_responses(session, before_utc=utc_after(-KEPT_FOR_S))
        if (known := response_under(session, self.key, owner)) is not None:
            return self._replay(known)
        answer = act()
        row = IdempotentResponse(
            key=self.key,
            actor=owner,
            request_sha256=self.request_sha256,
            status=answer.status,
            headers=dict(answer.headers),
            body=dict(answer.body if answer.kept is None else answer.kept),
            created_utc=utc_now(),
        )
        session.add(row)
        return answer.response()

    def _replay(self, known: IdempotentResponse) -> Response:
        """Give the remembered answer to the same request."""
        if known.request_sha256 != self.request_sha256:
            raise RefusedInputError(
                "This Idempotency-Key was used for another request; use a new key for a new request."
            )
        return json_response(known.body, known.status, {**known.headers, "Idempotent-Replayed": "true"})


def digest(request: Request, content: bytes) -> str:
    """Return the SHA-256 of a request: method, address and what it carries."""
    address = f"{request.method} {request.url.path}?{request.url.query}\n"
    return hashlib.sha256(address.encode() + content).hexdigest()


def _without_passwords(content: bytes) -> bytes:
    """Leave the passwords out of a JSON body: what is kept of a request must not help to guess one."""
    try:
        body = orjson.loads(content)
    except orjson.JSONDecodeError:
        return content
    if not isinstance(body, dict):
        return content
    return orjson.dumps({name: value for name, value in body.items() if name not in PASSWORDS})


IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=LONGEST_KEY,
        description="Send the same key again to get the same answer without a second effect.",
    ),
]


async def once(request: Request, asked: OnlyAsked, idempotency_key: IdempotencyKey = None) -> Once:
    """Read the key, and digest the request if there is one."""
    if idempotency_key is None:
        return Once(None, "", asked)
    return Once(idempotency_key, digest(request, _without_passwords(await request.body())), asked)


Idempotent = Annotated[Once, Depends(once)]
