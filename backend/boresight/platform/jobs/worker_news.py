"""What the dispatcher of runs tells the rest of its server: how its workers are, and what became of a run."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True)
class WorkerState:
    """Owner name, whether it and its cluster are up, whether a worker ever joined, and its threads and tasks."""

    owner: str = ""
    turns: bool = False
    connected: bool = False
    joined: bool = False
    threads: int = 0
    tasks: int = 0


@dataclass(frozen=True)
class RunMoved:
    """The state of a run has changed: its row says how."""

    run_id: int
    attempt: int


@dataclass(frozen=True)
class RunProgress:
    """How far an attempt is, with the new points of its history, which only those who follow the run are sent."""

    run_id: int
    attempt: int
    fraction: float
    message: str
    elapsed_s: float
    history: dict[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Write it as every listener is sent it, without its history."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "history"}
