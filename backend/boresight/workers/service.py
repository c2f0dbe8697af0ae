"""Schedulers and workers as services: started by a command, ended by SIGTERM, reconnecting by themselves.

distributed's workers end when they lose their scheduler, on purpose: what they held is void. So a worker here is a loop: wait until
the scheduler answers, be a worker of it until it is gone, wait again, longer each time that it did not last. A worker process
that dies under a scheduler that lives is replaced by its nanny.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import dask
from dask.system import CPU_COUNT
from distributed import Security
from distributed.core import rpc
from distributed.system import MEMORY_LIMIT

from boresight.platform.observability import logs
from boresight.settings import Settings
from boresight.workers.cluster import CONFIGURATION, MEMORY_SHARE, Nanny, Scheduler
from boresight.workers.security import PROTOCOL, make_security, refuse_open_link
from boresight.workers.tasks import WarmUp

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
LASTED_S = 60.0
ANSWER_S = 5.0
CLOSE_S = 10.0
Say = Callable[[str], None]


def run_scheduler(settings: Settings, host: str, port: int, say: Say) -> None:
    """Run a scheduler until SIGTERM or Ctrl-C."""
    logs.configure(settings.log_format)
    say = logs.sayer(settings.log_format, say)
    security = make_security(settings)
    if security is None:
        refuse_open_link(settings, host, f"--host {host}")
    _configure(settings)
    try:
        asyncio.run(_until_stopped(_scheduler(security, host, port, say)))
    except RuntimeError as error:
        if isinstance(error.__cause__, OSError):  # distributed wraps the cause of a failed start
            raise error.__cause__ from error
        raise


async def _scheduler(security: Security | None, host: str, port: int, say: Say) -> None:
    """Serve as a scheduler; a task that loses its worker is lost at once, because the server decides on retries."""
    scheduler = Scheduler(
        host=host,
        port=port,
        protocol=PROTOCOL if security else "tcp://",
        security=security,
        dashboard=False,
        allowed_failures=0,
    )
    async with scheduler:
        say(f"Boresight's scheduler on {scheduler.address}. Stop it with Ctrl-C.")
        try:
            await scheduler.finished()
        finally:
            await scheduler.close(reason="stopped")


@dataclass(frozen=True)
class WorkerService:
    """A worker that joins its scheduler again whenever that is there."""

    settings: Settings
    memory_bytes: int
    say: Say

    async def run(self) -> None:
        """Join the scheduler, again and again until stopped."""
        security = make_security(self.settings)
        pause_s = FIRST_PAUSE_S
        while True:
            await self._until_answered(security)
            joined_s = time.monotonic()
            await self._be_worker(security)
            pause_s = FIRST_PAUSE_S if time.monotonic() - joined_s > LASTED_S else min(2 * pause_s, LONGEST_PAUSE_S)
            self.say(f"A worker has left {self.settings.scheduler}; in {pause_s:.0f} s it tries to join again.")
            await asyncio.sleep(pause_s)

    async def _until_answered(self, security: Security | None) -> None:
        said = False
        while not await _answers(self.settings.scheduler, security):
            if not said:
                self.say(f"No scheduler answers at {self.settings.scheduler}; the worker waits for it.")
                said = True
            await asyncio.sleep(FIRST_PAUSE_S)

    async def _be_worker(self, security: Security | None) -> None:
        nanny = Nanny(
            self.settings.scheduler,
            nthreads=1,
            memory_limit=self.memory_bytes,
            security=security,
            silence_logs=logging.CRITICAL,
            plugins=(WarmUp(str(self.settings.catalogue_folder), ours=True, log_format=self.settings.log_format),),
        )
        try:
            await nanny
            self.say(f"A worker has joined {self.settings.scheduler}.")
            await nanny.finished()
        except (OSError, TimeoutError, RuntimeError) as error:
            self.say(f"The worker could not join, {type(error).__name__}: {error}")
        finally:
            with contextlib.suppress(Exception):
                await nanny.close(timeout=CLOSE_S, reason="stopped")


def run_workers(settings: Settings, processes: int, memory_bytes: int | None, say: Say) -> None:
    """Run a number of workers until SIGTERM or Ctrl-C."""
    logs.configure(settings.log_format)
    say = logs.sayer(settings.log_format, say)
    make_security(settings)
    _configure(settings)
    memory_bytes = memory_bytes or int(MEMORY_SHARE * MEMORY_LIMIT / max(processes, CPU_COUNT))

    async def all_of_them() -> None:
        await asyncio.gather(*(WorkerService(settings, memory_bytes, say).run() for _ in range(processes)))

    asyncio.run(_until_stopped(all_of_them()))


async def _answers(address: str, security: Security | None) -> bool:
    arguments = security.get_connection_args("worker") if security else {}
    scheduler = rpc(address, connection_args=arguments, timeout=ANSWER_S)
    try:
        await asyncio.wait_for(scheduler.identity(), ANSWER_S)
    except (OSError, TimeoutError):
        return False
    finally:
        with contextlib.suppress(Exception):
            await scheduler.close_rpc()
    return True


async def _until_stopped(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine until it ends, or until a signal asks to stop it in order."""
    task = asyncio.ensure_future(work)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


def _configure(settings: Settings) -> None:
    """Configure distributed without open ports and log messages of text, except those about memory."""
    dask.config.set(CONFIGURATION)
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL)
    if settings.log_format == "text":
        logging.getLogger("distributed.nanny.memory").addHandler(logging.StreamHandler())
