"""The cluster executor: a large run computes its pieces itself and lends pieces to idle workers."""

from __future__ import annotations

import contextlib
import contextvars
import math
import secrets
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import get_client, get_worker

from boresight.errors import CancelledError
from boresight.estimation.executor import ProgressCallback

GROUP_S = 0.5
LEAST_S = 0.05

#: Indices of the pieces of one group, ascending.
Group = tuple[int, ...]


@dataclass(frozen=True)
class FailedPiece:
    """Takes the place of a result: the exception that the piece raised."""

    error: Exception


class Pieces:
    """The state of the pieces of a map, shared by several threads."""

    def __init__(self, count: int, seconds: float | None = None) -> None:
        self.count = count
        self.seconds = seconds
        self._lock = threading.Condition()
        self._news = threading.Event()
        self._fresh = deque(range(count))
        self._returned: deque[int] = deque()
        self._results: dict[int, Any] = {}
        self._end = count  # pieces after the first failed one are not computed
        self._closed = False

    def take(self, takers: int, *, returned: bool = False) -> Group:
        """Take the next group; empty when there is none."""
        with self._lock:
            while returned and self._returned:
                place = self._returned.popleft()
                if place < self._end and place not in self._results:
                    return (place,)
            left = sum(place < self._end for place in self._fresh) if self._end < self.count else len(self._fresh)
            size = min(left, self._size(left, takers))
            return tuple(self._fresh.popleft() for _ in range(size))

    def _size(self, left: int, takers: int) -> int:
        if not self.seconds:
            return 1
        most, least = max(1, int(GROUP_S / self.seconds)), math.ceil(LEAST_S / self.seconds)
        return max(1, min(most, max(least, math.ceil(left / (2 * takers)))))

    def give_back(self, group: Group) -> None:
        """Return a group that was lost or is overdue; its former worker may still settle it."""
        with self._lock:
            self._returned.extend(place for place in group if place not in self._results)
            self._lock.notify_all()
        self._news.set()

    def settle(self, group: Group, results: Sequence[Any], seconds: float) -> None:
        """Store the results of a group, up to the first `FailedPiece`; the first result of a piece counts."""
        with self._lock:
            for place, result in zip(group, results, strict=False):
                self._results.setdefault(place, result)
                if isinstance(result, FailedPiece):
                    self._end = min(self._end, place)
            self.seconds = seconds / max(1, len(results))
        self._news.set()

    def await_news(self, seconds: float) -> None:
        """Wait for news with a timeout in seconds; for the one gathering thread."""
        self._news.wait(seconds)
        self._news.clear()

    def tell_news(self) -> None:
        """Signal news to the gathering thread."""
        self._news.set()

    def rest(self, seconds: float) -> None:
        """Wait with a timeout in seconds until a group is given back or all is done."""
        with self._lock:
            self._lock.wait(seconds)

    def close(self) -> None:
        """Stop handing out groups."""
        with self._lock:
            self._closed = True
            self._fresh.clear()
            self._returned.clear()
            self._lock.notify_all()

    @property
    def closed(self) -> bool:
        """Whether no more groups are handed out."""
        return self._closed

    @property
    def done(self) -> int:
        """The number of pieces with a result."""
        return len(self._results)

    @property
    def complete(self) -> bool:
        """Whether every piece has a result, or every one before the first that failed."""
        with self._lock:
            return all(place in self._results for place in range(self._end)) if self.done >= self._end else False

    def results(self) -> list[Any]:
        """Return the results in order."""
        if self._end < self.count:
            error: Exception = self._results[self._end].error
            raise error
        return [self._results[place] for place in range(self.count)]


LENT_TOPIC = "boresight-lent"
LOOK_EVERY_S = 0.5
WAIT_S = 0.1
FETCH_S = 2.0
OVERDUE_S = 3.0
OVERDUE_TIMES = 4
AT_ONCE_S = 0.05
BEHIND_RUNS = -1  # priority
DEEP = 2  # groups per worker: one being computed and the next, so that the worker does not wait

#: A worker, and which of its groups.
Slot = tuple[str, int]


@dataclass
class LentGroup:
    """A group that another worker computes."""

    future: Any
    group: Group
    lent_s: float
    overdue: bool = False


class ClusterExecutor:
    """An `Executor` for one attempt of a run, created and used in the thread of its task."""

    def __init__(self, name: str, folder: Path, cancelled: Callable[[], bool]) -> None:
        self._worker = get_worker()
        self._cancelled = cancelled
        self._seconds: dict[str, float | None] = {}
        self._idle: list[str] = []
        self._looked_s = -LOOK_EVERY_S
        self._blind: set[str] = set()
        self._keys = (f"piece-{name}-{secrets.token_hex(3)}-{n}" for n in range(1 << 60))
        self._sign = folder / f".seen-{secrets.token_hex(8)}"
        self._sign.touch()

    def map(
        self,
        function: Callable[..., Any],
        arguments: Sequence[tuple[Any, ...]],
        *,
        done: ProgressCallback | None = None,
    ) -> list[Any]:
        """Call `function(*arguments[k])` for every k and return the results in the order of k."""
        kind = f"{function.__module__}.{function.__qualname__}"
        pieces = Pieces(len(arguments), self._seconds.get(kind))
        work = _MapWork(function, arguments, pieces)
        try:
            if pieces.count < 2 or (pieces.seconds is not None and pieces.seconds * pieces.count < AT_ONCE_S):
                self._compute_alone(work, done)
            else:
                self._compute_with_others(work, done)
        finally:
            self._seconds[kind] = pieces.seconds
            pieces.close()
        return pieces.results()

    def _compute_alone(self, work: _MapWork, done: ProgressCallback | None) -> None:
        """Compute alone for a moment, because short work ends before others could begin."""
        while not work.pieces.complete:
            self._refuse_if_cancelled(work.pieces)
            work.compute(work.pieces.take(1, returned=True))
            _tell(work.pieces, done)

    def _compute_with_others(self, work: _MapWork, done: ProgressCallback | None) -> None:
        """Compute in a second thread, lend groups and gather results, until all are there."""
        loans: dict[Slot, LentGroup] = {}
        here = contextvars.copy_context().run
        threading.Thread(target=here, args=(work.compute_all, loans), daemon=True, name="boresight-pieces").start()
        told = 0
        try:
            while not work.pieces.complete:
                self._refuse_if_cancelled(work.pieces)
                self._gather(work, loans)
                self._lend(work, loans)
                if work.pieces.done > told:
                    told = _tell(work.pieces, done)
                work.pieces.await_news(WAIT_S)
        finally:
            for loan in loans.values():
                with contextlib.suppress(Exception):  # ending must not fail because of a worker that is gone
                    loan.future.cancel()
        if work.pieces.done > told:
            _tell(work.pieces, done)

    def _refuse_if_cancelled(self, pieces: Pieces) -> None:
        if self._cancelled():
            raise CancelledError(f"Cancelled after {pieces.done} of {pieces.count} pieces")

    def _lend(self, work: _MapWork, loans: dict[Slot, LentGroup]) -> None:
        """Lend groups to every idle worker, first one to each."""
        idle = self._idle_workers(loans)
        for number, worker in ((number, worker) for number in range(DEEP) for worker in idle):
            if (worker, number) in loans:
                continue
            group = work.pieces.take(2 + len(loans))
            if not group:
                return
            self._tell_lent(worker, _patience_s(work.pieces, group))
            future = get_client().submit(
                compute_group,
                str(self._sign),
                work.function,
                [work.arguments[place] for place in group],
                key=next(self._keys),
                pure=False,
                workers=[worker],
                priority=BEHIND_RUNS,
            )
            future.add_done_callback(lambda _: work.pieces.tell_news())
            loans[worker, number] = LentGroup(future, group, time.monotonic())

    def _idle_workers(self, loans: dict[Slot, LentGroup]) -> list[str]:
        """Return the workers that compute only what we lent them, read twice a second."""
        if time.monotonic() - self._looked_s >= LOOK_EVERY_S:
            self._looked_s = time.monotonic()
            ours = {loan.future.key for loan in loans.values()}
            try:
                at_work = get_client().processing()
            except OSError:  # the scheduler is busy or gone; the run does not depend on it
                at_work = {}
            busy = {worker for worker, keys in at_work.items() if not ours.issuperset(map(str, keys))}
            self._idle = sorted(at_work.keys() - busy - self._blind - {self._worker.address})
        return self._idle

    def _gather(self, work: _MapWork, loans: dict[Slot, LentGroup]) -> None:
        """Collect finished groups, and give back those that are lost or overdue."""
        for (worker, number), loan in list(loans.items()):
            if loan.future.done():
                del loans[worker, number]
                self._tell_lent(
                    worker, 0.0 if (worker, 1 - number) not in loans else _patience_s(work.pieces, loan.group)
                )
                if not self._taken_in(work.pieces, worker, loan):
                    self._idle = [other for other in self._idle if other != worker]
                    work.pieces.give_back(loan.group)
            elif not loan.overdue and time.monotonic() - loan.lent_s > _patience_s(work.pieces, loan.group):
                loan.overdue = True
                work.pieces.give_back(loan.group)

    def _taken_in(self, pieces: Pieces, worker: str, loan: LentGroup) -> bool:
        """Settle a returned group; False when it has no results."""
        try:
            answer = loan.future.result(timeout=FETCH_S)
        except Exception:  # noqa: BLE001 - its worker died, or could not even begin: the run will see by itself
            return False
        if answer is None:
            self._blind.add(worker)
            return False
        results, seconds = answer
        pieces.settle(loan.group, results, seconds)
        return True

    def _tell_lent(self, worker: str, for_s: float) -> None:
        """Tell the dispatcher how long a worker will have pieces of another run; 0 when it has just returned them."""
        self._worker.log_event(LENT_TOPIC, {"worker": worker, "for_s": for_s})


@dataclass(frozen=True)
class _MapWork:
    """The work of one `map` call."""

    function: Callable[..., Any]
    arguments: Sequence[tuple[Any, ...]]
    pieces: Pieces

    def compute(self, group: Group) -> None:
        """Compute a group here."""
        results, seconds = timed(self.function, [self.arguments[place] for place in group])
        self.pieces.settle(group, results, seconds)

    def compute_all(self, loans: dict[Slot, LentGroup]) -> None:
        """Compute groups until all are done, returned ones first."""
        while not self.pieces.closed and not self.pieces.complete:
            group = self.pieces.take(2 + len(loans), returned=True)
            if group:
                self.compute(group)
            else:
                self.pieces.rest(WAIT_S)


def compute_group(sign: str, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
    """Compute a group on another worker."""
    return timed(function, arguments) if Path(sign).exists() else None


def timed(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> tuple[list[Any], float]:
    """Call a function for each piece; returns the results, the last one `FailedPiece` where one raised, and the time taken."""
    begun_s = time.perf_counter()
    results: list[Any] = []
    for piece in arguments:
        try:
            results.append(function(*piece))
        except Exception as error:  # noqa: BLE001 - whatever it is, it is raised where the map was asked for
            results.append(FailedPiece(error))
            break
    return results, time.perf_counter() - begun_s


def _patience_s(pieces: Pieces, group: Group) -> float:
    """Return how long a group may be lent before it is computed here as well."""
    return max(OVERDUE_S, OVERDUE_TIMES * len(group) * (pieces.seconds or 0.0))


def _tell(pieces: Pieces, done: ProgressCallback | None) -> int:
    """Report the number of finished pieces."""
    count = pieces.done
    if done is not None:
        done(count, pieces.count)
    return count


FORGOTTEN_S = 86_400.0


@contextmanager
def make_scratch_folder(folder: Path, run_id: int, attempt: int) -> Iterator[Path]:
    """Create an attempt's temporary folder below `folder`, removed at the end."""
    folder.mkdir(exist_ok=True)  # the data folder may have been moved away and must not be created again
    for left in folder.glob("run-*-*"):
        if left.name.startswith(f"run-{run_id}-") or _age_s(left) > FORGOTTEN_S:
            shutil.rmtree(left, ignore_errors=True)
    own = folder / f"run-{run_id}-{attempt}"
    own.mkdir(exist_ok=True)
    try:
        yield own
    finally:
        shutil.rmtree(own, ignore_errors=True)


def _age_s(folder: Path) -> float:
    """Return the time since anything in a folder was last changed, seconds."""
    try:
        return time.time() - max(path.stat().st_mtime for path in (folder, *folder.glob("*")))
    except OSError:  # it has just been removed
        return 0.0
