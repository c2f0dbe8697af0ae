"""The whole study: which sets, on how many processes, and the document that comes out; the clock runs when they are done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boresight.errors import RefusedInputError
from boresight.studies.documents import versions
from boresight.studies.processes import run_all, run_on_one_thread
from boresight.studies.wu.document import document
from boresight.studies.wu.estimators import FIRST_FRAMES
from boresight.studies.wu.timing import timing
from boresight.studies.wu.trials import Record, Trial, run_trial

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Plan:
    """How large a study is.

    Parameters
    ----------
    quick
        Whether its sizes are the quick ones; said in the report.
    frames, judges
        Images that calibrate, and that judge.
    sets
        Simulated sets of each group.
    processes
        Sets at a time; 1 runs them in this process. The clock has a process of its own, with one thread.
    """

    quick: bool = False
    frames: int = 2400
    judges: int = 100
    sets: int = 20
    processes: int = 2


def run(plan: Plan, catalogue_folder: Path | None, report: Report | None = None) -> dict[str, Any]:
    """Run the study; returns its document, schema `boresight.reproduction/1`.

    Parameters
    ----------
    plan
        How large.
    catalogue_folder
        Where the trimmed star catalogue is cached, or None.
    report
        Told what ended and the fraction done.

    Raises
    ------
    RefusedInputError
        When the images are too few to take R anew.
    """
    if plan.frames <= FIRST_FRAMES:
        raise RefusedInputError(f"{plan.frames} images are too few: the study needs more than {FIRST_FRAMES}.")
    trials, records = (
        [Trial(index, plan.frames, plan.judges) for index in range(plan.sets)],
        dict[Trial, list[Record]](),
    )
    for trial, found in run_all(run_trial, trials, catalogue_folder, plan.processes):
        records[trial] = found
        if report is not None:
            report(f"set {trial.index + 1} of {plan.sets}", 0.9 * len(records) / len(trials))
    measured = run_on_one_thread(timing, catalogue_folder)
    if report is not None:
        report("times", 1.0)
    return document(_described(plan), [record for trial in trials for record in records[trial]], measured)


def _described(plan: Plan) -> dict[str, Any]:
    """The plan as JSON, with the versions that computed it."""
    return {
        "quick": plan.quick,
        "frames": plan.frames,
        "judges": plan.judges,
        "sets": plan.sets,
        "versions": versions(),
    }
