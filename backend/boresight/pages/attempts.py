"""Making a change on a person's behalf and getting a refusal back as a value, to be shown where the person is.

The transaction is the request's own (`boresight.api.dependencies.write_session`): a refusal passes through it first, so
nothing of a refused change is kept, and only then becomes words on the page.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from http import HTTPStatus
from typing import Generic, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from boresight.api.dependencies import check_own, write_session
from boresight.api.problems import problem_of
from boresight.errors import BoresightError, Fault, NotFoundError
from boresight.services.actors import Actor

T = TypeVar("T")
_transaction = asynccontextmanager(write_session)


@dataclass(frozen=True)
class Refusal:
    """Why a change was not made: the sentence, the places it names, and how HTTP says it.

    `render` takes status and headers from here for every page that shows a refusal.
    """

    error: BoresightError
    sentence: str
    faults: tuple[Fault, ...]
    status: int
    headers: Mapping[str, str]

    @classmethod
    def of(cls, error: BoresightError) -> Refusal:
        """Turn a refusal that was raised into one to show."""
        problem = problem_of(error)
        return cls(error, str(error), tuple(getattr(error, "faults", ())), problem.status, problem.headers or {})

    @property
    def is_ours(self) -> bool:
        """Whether the server lacks something, such as room on its disk, and not what was asked is at fault."""
        return self.status >= HTTPStatus.INTERNAL_SERVER_ERROR


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """What came of an attempt: the value, or the refusal."""

    value: T | None
    refusal: Refusal | None

    @property
    def made(self) -> T:
        """The value, where nothing was refused."""
        if self.value is None:
            raise ValueError("there is no value: read the refusal first")
        return self.value


async def attempt(
    request: Request, change: Callable[..., T], prepare: Callable[[], Awaitable[Sequence[object]]] | None = None
) -> Outcome[T]:
    """Make a change in the request's writing transaction.

    Parameters
    ----------
    change
        `(session, *prepared) -> value`.
    prepare
        What is slow and needs no transaction, such as checking a password; done before the transaction begins.

    Raises
    ------
    NotFoundError
        Passed on: there is no page to show the refusal on.
    """
    try:
        prepared = () if prepare is None else await prepare()
        async with _transaction(request) as session:
            return Outcome(await run_in_threadpool(change, session, *prepared), None)
    except NotFoundError:
        raise
    except BoresightError as error:
        return Outcome(None, Refusal.of(error))


def proof_of_own(request: Request, actor: Actor, password: str) -> Callable[[], Awaitable[Sequence[object]]]:
    """Return what checks the password of who acts, for `attempt` to do first."""

    async def prepare() -> Sequence[object]:
        return (await check_own(request, actor, password),)

    return prepare
