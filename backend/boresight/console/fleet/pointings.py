"""What a sensor is to observe next: a plan of pointings within a budget of time, computed outside of every transaction."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from boresight.calibration.calibration import USABLE, Calibration, parse_calibration
from boresight.console.fleet.tables import Sensor
from boresight.console.list_queries import list_newest
from boresight.console.parameter_sets.queries import list_sets_in
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.results import read_result
from boresight.console.runs.starts import TRUSTED, find_start
from boresight.console.runs.tables import Run
from boresight.errors import OverloadedError, RefusedInputError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session
from boresight.simulation.plans import CANDIDATE_COLUMNS, PointingPlan, check_constraints, make_plan, parse_candidates
from boresight.simulation.pointings import Candidates, Constraints, Criterion
from boresight.simulation.scenes import parse_orbit, parse_start
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.sensors import parse_sensor

#: What one request may ask for: seconds of one core.
MOST_CANDIDATES, MOST_DWELLS = 5_000, 60
#: How long a request waits for the one before it, and when it may come back.
PATIENCE_S, COME_BACK_S = 5.0, 5
#: Runs that a form offers.
MOST_OFFERED = 20

#: What begins a line of candidates that is a heading.
_HEADING = CANDIDATE_COLUMNS[0]

#: A plan keeps a core busy: of those that come together one is computed at a time.
_computing = threading.Semaphore()


def read_known(
    session: Session, blobs: BlobStore, sensor: Sensor, run_id: int | None, set_id: int | None
) -> Calibration | None:
    """Read the calibration that a plan adds to, named as a run or as a parameter set; None where none is."""
    start = find_start(session, sensor, run_id, set_id)
    if start is None or start.run.result_sha256 is None:
        return None
    return parse_calibration(read_result(blobs, start.run.result_sha256, start.run.id))


def read_constraints(start_utc: str, orbit: Mapping[str, float] | None, given: Mapping[str, Any]) -> Constraints:
    """Read what a plan has to keep; refuses what makes none, and more dwells than one request may ask for."""
    begins = parse_start(start_utc)
    constraints = Constraints(start_utc=begins, orbit=None if orbit is None else parse_orbit(orbit, begins), **given)
    check_constraints(constraints)
    if (dwells := int(60.0 * constraints.minutes / constraints.dwell_s)) > MOST_DWELLS:
        raise RefusedInputError(
            f"{constraints.minutes:g} minutes allow {dwells:,} dwells of {constraints.dwell_s:g} s, but a server plans at most "
            f"{MOST_DWELLS}: use fewer minutes or longer dwells; `boresight plan` on your own machine has no such limit."
        )
    return constraints


def read_candidates(attitudes_deg: Sequence[Sequence[float]] | None) -> Candidates | None:
    """Read attitudes that may be chosen, each as right ascension, declination and roll; None searches the whole sky."""
    if attitudes_deg is None:
        return None
    columns = np.array(attitudes_deg, np.float64).reshape(-1, len(CANDIDATE_COLUMNS)).T
    return parse_candidates(list(columns), lambda index: f"candidates[{index}]")


def read_candidate_lines(text: str) -> list[list[float]] | None:
    """Read attitudes as they are typed or pasted, one a line, under a heading or without; None where there are none."""
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    lines = [(k, line) for k, line in lines if not line.startswith(_HEADING)]
    if len(lines) > MOST_CANDIDATES:
        raise RefusedInputError(f"{len(lines):,} candidates were given: give up to {MOST_CANDIDATES:,}.")
    rows = []
    for k, line in lines:
        try:
            row = [float(one) for one in line.replace(",", " ").replace(";", " ").split()]
        except ValueError:
            row = []
        if len(row) != len(CANDIDATE_COLUMNS):
            raise RefusedInputError(
                f"Line {k} of the candidates is {line[:40]!r}: write {', '.join(CANDIDATE_COLUMNS)} in degrees, one a line."
            )
        rows.append(row)
    return rows or None


def list_known(session: Session, sensor: Sensor) -> tuple[list[ParameterSet], list[Run]]:
    """Return what a plan may add to: the sets of a sensor that may be started from, and its newest runs that converged."""
    runs = list_newest(
        session, Run, sensor=sensor.id, state="SUCCEEDED", status=USABLE, in_use=True, limit=MOST_OFFERED
    )
    return list_sets_in(session, [sensor.id], TRUSTED), runs


def compute(
    document: Mapping[str, Any],
    known: Calibration | None,
    candidates: Candidates | None,
    constraints: Constraints,
    criterion: Criterion,
    stars: Callable[[], Catalogue],
) -> PointingPlan:
    """Plan for a sensor, whose document this is; seconds, and without the database."""
    with _turn():
        return make_plan(parse_sensor(document), known, candidates, constraints, criterion, stars())


@contextmanager
def _turn() -> Iterator[None]:
    if not _computing.acquire(timeout=PATIENCE_S):
        raise OverloadedError(f"The server is computing another plan; try again in {COME_BACK_S} s.", COME_BACK_S)
    try:
        yield
    finally:
        _computing.release()
