"""How distributed is set up wherever Boresight starts it: in the server, as a scheduler, as a worker."""

from __future__ import annotations

#: Of a machine, over its worker processes; the rest is the server's and the system's.
MEMORY_SHARE = 0.8
#: distributed opens a port for its dashboard in any case: without routes, and for this machine only.
NOWHERE = "127.0.0.1:0"
CONFIGURATION = {
    "distributed.admin.low-level-log-length": 100,  # progress events the scheduler keeps; each may hold a history
    "distributed.diagnostics.nvml": False,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
