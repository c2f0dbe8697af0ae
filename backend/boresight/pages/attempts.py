"""Making a change on a person's behalf and getting a refusal back as a value, to be shown where the person is.

The transaction is the request's own (`boresight.api.dependencies.write_session`): a refusal passes through it first, so
nothing of a refused change is kept, and only then becomes words on the page.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from boresight.api.dependencies import write_session
from boresight.errors import BoresightError, Fault, NotFoundError

T = TypeVar("T")
_transaction = asynccontextmanager(write_session)


@dataclass(frozen=True)
class Refusal:
    """Why a change was not made: the sentence, and the places it names."""

    sentence: str
    faults: tuple[Fault, ...] = ()


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """What came of an attempt: the value, or the refusal."""

    value: T | None
    refusal: Refusal | None


async def attempt(request: Request, change: Callable[..., T]) -> Outcome[T]:
    """Make a change in the request's writing transaction.

    Parameters
    ----------
    change
        `(session) -> value`.

    Raises
    ------
    NotFoundError
        Passed on: there is no page to show the refusal on.
    """
    try:
        async with _transaction(request) as session:
            return Outcome(await run_in_threadpool(change, session), None)
    except NotFoundError:
        raise
    except BoresightError as error:
        return Outcome(None, Refusal(str(error), tuple(getattr(error, "faults", ()))))
