"""How distributed is set up wherever Boresight starts it: in the server, as a scheduler, as a worker."""

from __future__ import annotations

#: Of a machine, over its worker processes; the rest is the server's and the system's.
MEMORY_SHARE = 0.8
#: Much of what distributed does beside tasks is for its own pages, which nobody opens here; it goes on whether anything is
#: computed or not, in the server's process for the scheduler and for the nanny of each worker.
CONFIGURATION = {
    "distributed.admin.low-level-log-length": 100,  # progress events the scheduler keeps; each may hold a history
    "distributed.admin.system-monitor.disk": False,  # of the whole machine
    "distributed.admin.system-monitor.gil.enabled": False,  # a thread that asks for the interpreter every millisecond
    "distributed.admin.system-monitor.interval": "5s",  # of 0.5 s; memory limits have a look of their own
    "distributed.admin.tick.interval": "1s",  # of 20 ms: whether the event loop is late, told from 3 s on
    "distributed.diagnostics.nvml": False,
    # gives every freed array back to the system at once, and each new one comes in pages that fault: a third of a short run's time
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.scheduler.active-memory-manager.start": False,  # drops copies of results; ours are fetched once
    "distributed.scheduler.work-stealing": False,  # every task names its worker
    "distributed.worker.memory.monitor-interval": "500ms",  # of 100 ms, by each worker and by its nanny
    "distributed.worker.profile.enabled": False,  # looks at the computing thread a hundred times a second
}
