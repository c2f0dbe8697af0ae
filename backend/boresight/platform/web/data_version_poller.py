"""The data version for requests on the event loop: read anew for each request, so that a client always sees its own commits.

SQLite answers on the spot. PostgreSQL is asked in a thread, one question at a time: who comes while one is under way waits for the
next, for that one may have been answered before something that they know of was committed; all who wait share the next answer.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from boresight.platform.db.data_version import DataVersion, DataVersionReader


class DataVersionPoller:
    """Polls the data version."""

    def __init__(self, marks: DataVersionReader) -> None:
        self._marks = marks
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="boresight-changes")
        self._under_way: asyncio.Task[DataVersion | None] | None = None
        self._next: asyncio.Task[DataVersion | None] | None = None

    async def now(self) -> DataVersion | None:
        """Return a mark that was looked for after this was called; None where the store cannot say."""
        if self._marks.at_once:
            return self._marks.look()
        loop = asyncio.get_running_loop()
        if self._next is None or self._next.get_loop() is not loop:
            self._next = loop.create_task(self._ask(self._under_way))
        return await asyncio.shield(self._next)

    async def _ask(self, before: asyncio.Task[DataVersion | None] | None) -> DataVersion | None:
        """Wait for the question before, then ask."""
        if before is not None and before.get_loop() is asyncio.get_running_loop():
            await asyncio.wait([before])
        self._under_way, self._next = self._next, None
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._marks.look)

    def close(self) -> None:
        """Stop polling."""
        self._thread.shutdown(wait=False)
        self._marks.close()
