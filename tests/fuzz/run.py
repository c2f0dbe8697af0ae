"""A whole run: so many requests, shared among every operation, every kind of document and every identity."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from tests.fuzz.documents import KINDS, fuzz_document
from tests.fuzz.judge import Asker, Tally
from tests.fuzz.operations import fuzz_operation
from tests.fuzz.world import World

OF_DOCUMENTS = 0.3
PIECE = 20  # requests of one operation at a time, so that what one did is there for the next


def fuzz(world: World, requests: int, seed: int = 1, tell: Any = None) -> Tally:
    """Send so many requests.

    Parameters
    ----------
    seed
        The same seed makes the same requests up.
    tell
        Called now and then with the tally.
    """
    tally, began_s, turn = Tally(), time.monotonic(), 0
    while tally.requests + tally.unsendable < requests:
        for job in _jobs(world):
            left = requests - tally.requests - tally.unsendable
            if left <= 0:
                break
            job(min(left, _piece(requests, world)), seed + turn, tally)
            if tell is not None:
                tell(tally, time.monotonic() - began_s)
        turn += 1
    return tally


def _piece(requests: int, world: World) -> int:
    jobs = len(world.operations) * len(world.askers) / (1 - OF_DOCUMENTS)
    return max(1, min(PIECE, int(requests / jobs)))  # so that one turn comes to every operation


def _jobs(world: World) -> Iterator[Any]:
    operations = [(operation, asker) for operation in world.operations.values() for asker in world.askers]
    documents = [(kind, asker) for kind in KINDS for asker in world.askers[:2]]
    share = OF_DOCUMENTS / (1 - OF_DOCUMENTS)
    due = 0.0
    taken = 0
    for operation, asker in operations:
        yield _of_operation(world, operation, asker)
        due += share
        while due >= 1:
            kind, document_asker = documents[taken % len(documents)]
            yield _of_document(world, kind, document_asker)
            taken, due = taken + 1, due - 1


def _of_operation(world: World, operation: Any, asker: Asker) -> Any:
    return lambda count, seed, tally: fuzz_operation(world, operation, asker, count, seed, tally)


def _of_document(world: World, kind: Any, asker: Asker) -> Any:
    return lambda count, seed, tally: fuzz_document(world, kind, asker, count, seed, tally)
