"""Whether a worker may compute for a server: the same version of Boresight, and the server's files in sight.

A plugin of the scheduler, so that it is asked of workers that come later as well. A worker that is not fit says so in one sentence,
in its own log and in the server's, and leaves; what it was given meanwhile goes back to the queue unharmed.
"""

from __future__ import annotations

import logging
import socket
from pathlib import Path
from typing import Any

from distributed.diagnostics.plugin import WorkerPlugin

import boresight

log = logging.getLogger(__name__)

UNFIT_TOPIC = "boresight-unfit"
LEAVE_AFTER_S = 0.5  # its sentence goes first


class Fitness(WorkerPlugin):  # type: ignore[misc]  # distributed ships no types
    """Ask every worker whether it may compute for this server.

    Parameters
    ----------
    version
        The server's.
    folder
        A folder that must be seen under the same path; empty asks nothing.
    """

    name = "boresight-fitness"

    def __init__(self, version: str, folder: str) -> None:
        self.version = version
        self.folder = folder

    def setup(self, worker: Any) -> None:
        """Let a worker that is not fit say why, and leave."""
        fault = fault_of(self.version, self.folder, boresight.__version__)
        if fault is None:
            return
        log.error(fault)
        worker.log_event(UNFIT_TOPIC, {"fault": fault})
        worker.loop.call_later(LEAVE_AFTER_S, worker.close, reason="boresight-unfit")


def fault_of(server_version: str, folder: str, worker_version: str) -> str | None:
    """Say in a sentence why a worker may not compute for a server; None when it may."""
    here = socket.gethostname()
    if worker_version != server_version:
        return (
            f"The worker on {here} is Boresight {worker_version} and the server is {server_version}: "
            "install the same version on both; until then this worker gets no runs."
        )
    if folder and not Path(folder).is_dir():
        return (
            f"The worker on {here} does not see the server's folder {folder}: mount it there under the same path; "
            "until then this worker gets no runs."
        )
    return None
