"""Work over a set in blocks of equal size, on as many threads as there are, with one answer whatever their number.

Floating-point sums depend on their order. Here a set's frames are cut into blocks of `FRAMES` frames, counted from its first
frame; each block is summed by itself, and the blocks' sums are added in their order. So the number of threads, the chunks in which
a set larger than memory is read, and the machines it is spread over change no bit of the result, as long as every chunk is a whole
number of blocks.

The compiled loops release the interpreter's lock, so threads share the set and copy nothing. Who calls decides how many: a worker
process computes on one thread, for there is one process a core; a command line has the machine to itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")

#: Frames a block: a millisecond or two of work, so that handing it to a thread costs nothing and two cores end together.
FRAMES = 1024

#: Threads beside the calling one, and how many.
_helpers: ContextVar[tuple[Executor, int] | None] = ContextVar("helpers", default=None)


@contextmanager
def computing_on(threads: int) -> Iterator[None]:
    """Let the blocks within be computed on so many threads.

    Parameters
    ----------
    threads
        1 computes in the calling thread; of more, the calling thread is one.
    """
    if threads <= 1:
        yield
        return
    with ThreadPoolExecutor(threads - 1, thread_name_prefix="boresight-block") as pool:
        token = _helpers.set((pool, threads - 1))
        try:
            yield
        finally:
            _helpers.reset(token)


def in_blocks(run: Callable[[int, int], T], count: int, size: int = FRAMES) -> list[T]:
    """Call `run(first, last)` for each block of `size` out of `count`, and return the results in the order of the blocks.

    Every thread takes the next block until none is left: one hand-over a thread and not one a block, and none waits for another.
    """
    edges = [(first, min(first + size, count)) for first in range(0, count, size)]
    helpers = _helpers.get()
    if helpers is None or len(edges) < 2:
        return [run(first, last) for first, last in edges]
    results: dict[int, T] = {}
    left = iter(range(len(edges)))  # taking from it is one step of the interpreter

    def take() -> None:
        for place in left:
            results[place] = run(*edges[place])

    pool, others = helpers
    running = [pool.submit(take) for _ in range(min(others, len(edges) - 1))]
    try:
        take()
    finally:
        wait(running)
    for helper in running:
        helper.result()
    return [results[place] for place in range(len(edges))]
