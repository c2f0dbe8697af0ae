"""The data version: a value that changes with every commit of any process.

Two equal versions of one `DataVersionReader` mean that both times the same rows were to be seen, so what was read after the first
still holds at the second. SQLite counts for each connection the commits of all others (`PRAGMA data_version`), so one connection
that never writes sees every one: a look costs some microseconds. PostgreSQL names its snapshot (`pg_current_snapshot()`): its text
changes when a transaction that wrote anything ends, in this database or another of the cluster, and a look costs a question to the
server. A version carries the number of its connection too: those of a later connection might meet it by chance.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, TypeVar

from boresight.disks import Opened
from boresight.platform.db.engines import OPENED
from boresight.platform.db.sessions import Engine

T = TypeVar("T")
Value = TypeVar("Value")
DataVersion = tuple[int, int | str]  # the number of the connection, and the value read over it
QUESTIONS = {"sqlite": "PRAGMA data_version", "postgresql": "SELECT pg_current_snapshot()::text"}


class DataVersionReader:
    """Reads the data version of one store over a connection of its own."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._question = QUESTIONS[engine.dialect.name]
        self._lock = threading.Lock()
        self._connection: Any = None
        self._file: Opened | None = None
        self._opened = 0

    @property
    def at_once(self) -> bool:
        """Whether reading is so fast that it needs no thread."""
        return self._engine.dialect.name == "sqlite"

    def look(self) -> DataVersion | None:
        """Return the current version; None where the store does not answer."""
        with self._lock:
            try:
                if self._connection is None:
                    self._connection = self._connect()
                self._refuse_another_file()
                seen = self._connection.dbapi_connection.execute(self._question).fetchone()[0]
            except Exception:  # noqa: BLE001 - the drivers' own errors differ, and each means that nothing is known
                self._let_go()
                return None
            return self._opened, seen

    def row(self, question: str, given: Mapping[str, int | str]) -> tuple[Any, ...] | None:
        """Return the first row of a query; None where there is none or the query needs a thread."""
        if not self.at_once:
            return None
        with self._lock:
            try:
                if self._connection is None:
                    self._connection = self._connect()
                self._refuse_another_file()
                found: tuple[Any, ...] | None = self._connection.dbapi_connection.execute(question, given).fetchone()
            except Exception:  # noqa: BLE001 - as above
                self._let_go()
                return None
            return found

    def _connect(self) -> Any:
        """Open a connection outside the pool and outside transactions, which waits for no lock."""
        self._opened += 1
        pooled = self._engine.raw_connection()
        self._file = pooled.info.get(OPENED)
        pooled.detach()  # detached from the pool, and open for as long as it is held
        connection: Any = pooled.dbapi_connection
        if self.at_once:
            connection.execute("PRAGMA busy_timeout=0").close()
        else:
            connection.rollback()
            connection.autocommit = True
        return pooled

    def _refuse_another_file(self) -> None:
        """Refuse to read a file that was moved away."""
        if self._file is not None:
            self._file.refuse_another()

    def _let_go(self) -> None:
        """Close a broken connection; the next call opens another, whose versions differ."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            self._let_go()


class DataVersionPoller:
    """The data version for requests on the event loop: read again for each, so that a client always sees its own commits.

    SQLite answers on the spot. PostgreSQL is asked in a thread, one question at a time: who comes while one is under way waits for
    the next, for that one may have been answered before something that they know of was committed; all who wait share the answer.
    """

    def __init__(self, reader: DataVersionReader) -> None:
        self._reader = reader
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="boresight-changes")
        self._under_way: asyncio.Task[DataVersion | None] | None = None
        self._next: asyncio.Task[DataVersion | None] | None = None

    async def read_now(self) -> DataVersion | None:
        """Return a version that was read after this call began; None where the store does not answer."""
        if self._reader.at_once:
            return self._reader.look()
        loop = asyncio.get_running_loop()
        if self._next is None or self._next.get_loop() is not loop:
            self._next = loop.create_task(self._ask(self._under_way))
        return await asyncio.shield(self._next)

    async def _ask(self, before: asyncio.Task[DataVersion | None] | None) -> DataVersion | None:
        """Wait for the query under way, then start another."""
        if before is not None and before.get_loop() is asyncio.get_running_loop():
            await asyncio.wait([before])
        self._under_way, self._next = self._next, None
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._reader.look)

    def close(self) -> None:
        """Stop polling."""
        self._thread.shutdown(wait=False)
        self._reader.close()


class VersionedCache(Generic[T]):
    """A cache of query results, valid until the next commit."""

    def __init__(self, reader: DataVersionReader) -> None:
        self._reader = reader
        self._last: tuple[Hashable, DataVersion, float, T] | None = None

    def answer(self, question: Hashable, read: Callable[[], T]) -> T:
        """Return the result of `read`, cached until the next commit."""
        return self.answer_to(question, read, math.inf)[0]

    def answer_to(self, question: Hashable, read: Callable[[], T], asked_s: float) -> tuple[T, bool]:
        """Return the same for a request that came at a monotonic time, and whether it is older than the newest commit."""
        began_s, last = time.monotonic(), self._last
        data_version = self._reader.look()  # before reading, so that no commit is missed
        if last is not None and last[0] == question and data_version is not None:
            if data_version == last[1]:
                return last[3], False
            if last[2] > asked_s:
                return last[3], True
        found = read()
        self._last = None if data_version is None else (question, data_version, began_s, found)
        return found, False


LARGEST_SHARE = 4  # of the limit, so that one large thing does not push everything else out


class SizeLimitedCache(Generic[Value]):
    """A thread-safe cache of recently used values by key; two threads that miss at once both compute the value."""

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self.held_bytes = 0
        self._kept: OrderedDict[Hashable, tuple[Value, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], tuple[Value, int]]) -> Value:
        """Return the value of a key, computed with its size in bytes where it is missing."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][0]
        value, size = make()
        if size * LARGEST_SHARE <= self.limit_bytes:
            self._keep(key, value, size)
        return value

    def _keep(self, key: Hashable, value: Value, size: int) -> None:
        """Store a value, and remove the oldest until the limit holds."""
        with self._lock:
            if key in self._kept:
                self.held_bytes -= self._kept.pop(key)[1]
            self._kept[key] = (value, size)
            self.held_bytes += size
            while self.held_bytes > self.limit_bytes:
                self.held_bytes -= self._kept.popitem(last=False)[1][1]
