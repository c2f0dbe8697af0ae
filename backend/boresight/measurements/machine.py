"""The machine that measured, and how busy it was: without them a time says nothing."""

from __future__ import annotations

import os
import platform
import sqlite3
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

#: Whose releases change the figures; those that are not installed are left out.
PACKAGES = (
    "boresight", "numpy", "scipy", "numba", "distributed", "pyarrow", "sqlalchemy", "fastapi", "uvicorn", "opencv-python-headless",
    "filterpy", "pyceres", "gtsam", "mrcal", "tetra3rs",
)  # fmt: skip


def machine() -> dict[str, Any]:
    """Describe the processor, its cores, memory, versions, the hour and the load averages of now."""
    return {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "versions": {"python": platform.python_version(), "sqlite": sqlite3.sqlite_version} | _versions(),
    }


def _processor() -> str:
    """Name of the processor as the system gives it."""
    cpu = Path("/proc/cpuinfo")
    named = cpu.read_text(encoding="utf-8").splitlines() if cpu.exists() else []
    return next((line.partition(":")[2].strip() for line in named if line.startswith("model name")), platform.machine())


def _versions() -> dict[str, str]:
    """Versions of the installed among `PACKAGES`."""
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
