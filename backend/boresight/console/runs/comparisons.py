"""Runs of one camera model set against a reference run: what differs, by how many sigmas, and on what assumption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from boresight.arrays import known_or_none
from boresight.calibration.calibration import Calibration, to_plain
from boresight.calibration.evaluation.contrast import (
    Contrast,
    RadialContrast,
    SharedData,
    contrast,
    radial_contrast,
    strong_correlations,
)
from boresight.cameras import CAMERA_MODELS
from boresight.console import list_queries as lists
from boresight.console.parameter_sets import queries as parameter_sets
from boresight.console.runs import queries
from boresight.console.runs import service as runs
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.sessions import Session
from boresight.telemetry.sampling import shared_exposures
from boresight.telemetry.sensors import DescribedCamera, read_described_camera

MOST_RUNS = 20
LONGEST_NUMBER = 18  # digits of a row's number
#: Columns of the table, and what they are called in the document, where each is a list a run.
COLUMNS = {
    "value": "values",
    "sigma": "sigmas",
    "difference": "differences",
    "sigma_of_difference": "sigmas_of_difference",
    "separation": "separations",
}
ASSUMPTION = (
    "The sigma of a difference takes into account which data two runs share. Runs of separate data: the variances add up."
    " A run within the other's data, or the same data with another method or other free parameters: the larger variance minus"
    " the smaller (Hausman), valid if the smaller sigma belongs to an efficient estimate. Partly shared data: each variance is"
    " weighted by the share of exposures not in the other run. Same data and equal sigmas: the difference comes from the"
    " methods and has no sigma of its own, so it is given in sigmas of the reference."
)


@dataclass(frozen=True)
class ComparedRun:
    """One run of a comparison with its result, complete or so far."""

    run: Run
    result: Calibration | None

    @property
    def calibration(self) -> Calibration:
        """The typed result; an empty one where the run has none."""
        return self.result or Calibration(status="running")

    @property
    def camera_model(self) -> str:
        """The camera model the run was launched with."""
        return self._camera.camera_model

    @property
    def detector(self) -> tuple[int, int, float]:
        """Rows, columns and pixel pitch in metres of the sensor at launch."""
        camera = self._camera
        return camera.rows, camera.columns, camera.pixel_pitch_m

    @cached_property
    def _camera(self) -> DescribedCamera:
        return read_described_camera(self.run.sensor_document)


@dataclass(frozen=True)
class Comparison:
    """Runs against a reference."""

    compared: Sequence[ComparedRun]
    reference: int
    names: tuple[str, ...]
    shared: Sequence[SharedData]
    sentences: Sequence[str]
    contrasts: Sequence[Contrast | None]

    def correlations(self) -> list[tuple[str, str, list[float | None]]]:
        """List the strong correlations, a number a run."""
        return strong_correlations([one.calibration for one in self.compared], self.names)

    def radial(self) -> list[RadialContrast | None]:
        """Compute the radial difference of each run to the reference; None where it cannot be computed."""
        base = self.compared[self.reference]
        return [
            radial_contrast(one.calibration, base.calibration, against, base.detector)
            if against is not None and one.detector == base.detector
            else None
            for one, against in zip(self.compared, self.contrasts, strict=True)
        ]


class UnlikeModelsError(RefusedInputError):
    """The runs have different camera models; `sets` are their parameter sets that could be converted."""

    def __init__(self, message: str, sets: Sequence[tuple[int, str]]) -> None:
        super().__init__(message, code="unlike-models")
        self.sets = sets


def read_run_ids(asked: Sequence[str]) -> list[int]:
    """Read run numbers from `1,2,3` or from repeated fields, each once, in their order."""
    texts = [text.strip() for part in asked for text in part.split(",") if text.strip()]
    if strange := [text for text in texts if not text.isdecimal()]:
        raise RefusedInputError(f"{strange[0][:20]!r} is not a run number; give them as ?runs=1,2,3.")
    if any(len(text.lstrip("0")) > LONGEST_NUMBER for text in texts):
        raise NotFoundError("There is no run with so large a number; choose from the list.", code="number-too-large")
    found = list(dict.fromkeys(int(text) for text in texts))
    if len(found) > MOST_RUNS:
        raise RefusedInputError(
            f"{len(found)} runs were chosen; at most {MOST_RUNS} can be compared. Leave out {len(found) - MOST_RUNS}."
        )
    return found


def read_runs(session: Session, run_ids: Sequence[int]) -> list[Run]:
    """Read the rows of several runs in one query, in the order asked for."""
    found = {run.id: run for run in lists.list_newest(session, Run, among=list(run_ids), limit=MOST_RUNS)}
    if missing := [run_id for run_id in run_ids if run_id not in found]:
        raise NotFoundError(f"There is no run {missing[0]}; choose one from the list.")
    return [found[run_id] for run_id in run_ids]


def read_compared(session: Session, blobs: BlobStore, run_ids: Sequence[int]) -> list[ComparedRun]:
    """Read the runs and their results."""
    found = [ComparedRun(run, runs.find_calibration(session, blobs, run.id)) for run in read_runs(session, run_ids)]
    models = {one.camera_model: one.run.id for one in reversed(found)}
    if len(models) > 1:
        (first, first_id), (second, second_id) = sorted(models.items(), key=lambda item: run_ids.index(item[1]))[:2]
        sets = [row for one in found if (row := parameter_sets.find_set_of_run(session, one.run.id)) is not None]
        raise UnlikeModelsError(
            f"Run #{first_id} uses the camera model {first} and run #{second_id} uses {second}: their parameters are not"
            " the same quantities. Compare runs of one model, or make a parameter set from a run and open its page: it shows the"
            " set converted to the other model.",
            [(row.id, row.name) for row in sets],
        )
    return found


def compare(session: Session, blobs: BlobStore, run_ids: Sequence[int], reference_id: int | None = None) -> Comparison:
    """Set runs against one of them, the first where none is named."""
    if len(run_ids) < 2:
        raise RefusedInputError("A comparison needs two runs or more; give them as ?runs=1,2.", code="too-few-runs")
    if reference_id is not None and reference_id not in run_ids:
        raise RefusedInputError(
            f"Run #{reference_id} is not among those compared; choose the reference among them.",
            code="reference-not-compared",
        )
    compared = read_compared(session, blobs, run_ids)
    place = 0 if reference_id is None else run_ids.index(reference_id)
    base = compared[place]
    names = CAMERA_MODELS[base.camera_model].parameter_names
    related = [_describe_shared(session, blobs, one.run, base.run) for one in compared]
    contrasts = [
        contrast(one.calibration, base.calibration, names, shared)
        if one is not base and one.calibration.parameters and base.calibration.parameters
        else None
        for one, (shared, _) in zip(compared, related, strict=True)
    ]
    return Comparison(compared, place, names, [one for one, _ in related], [said for _, said in related], contrasts)


def _describe_shared(session: Session, blobs: BlobStore, run: Run, reference: Run) -> tuple[SharedData, str]:
    """Return the data that a run shares with the reference, in numbers and in words."""
    if run.sensor_id != reference.sensor_id:
        return SharedData(0, 0), "another sensor: the difference includes how the two sensors differ"
    mine, theirs = (queries.list_held_sets(session, row) for row in (run, reference))
    if max(len(mine), len(theirs)) > 1:
        return _describe_shared_sets(session, mine, theirs)
    one, other = (session.get_one(TelemetrySet, row.telemetry_set_id) for row in (run, reference))
    if one.table_sha256 == other.table_sha256:
        return SharedData(1, 1), f"the same data, {one.name}"
    try:
        shares = shared_exposures(table_path(blobs, one.table_sha256), table_path(blobs, other.table_sha256))
    except (NotFoundError, RefusedInputError):
        return SharedData(
            0, 0
        ), f"{one.name} and {other.name}, treated as separate data: one of their files cannot be read"
    shared = SharedData(*shares)
    words = {
        "same": f"the same exposures in {one.name} and {other.name}",
        "inside": f"{one.name} is part of {other.name}",
        "around": f"{one.name} contains {other.name}",
        "partly": f"{shares[0]:.0%} of the exposures of {one.name} are in {other.name}",
        "disjoint": f"separate data, {one.name} and {other.name}",
    }
    return shared, words[shared.kind]


def _describe_shared_sets(session: Session, mine: set[int], theirs: set[int]) -> tuple[SharedData, str]:
    """Return what two estimates share that rest on several sets, those of their priors among them, by the sets' stars."""
    stars = {number: session.get_one(TelemetrySet, number).stars for number in mine | theirs}
    both = sum(stars[number] for number in mine & theirs)
    shared = SharedData(*(both / max(sum(stars[number] for number in held), 1) for held in (mine, theirs)))
    if mine == theirs:
        return shared, f"the same {len(mine)} sets"
    return shared, f"{len(mine & theirs)} of its {len(mine)} sets, also used by the other run"


def document(comparison: Comparison) -> dict[str, Any]:
    """Write a comparison as JSON; numbers in SI, null where nothing is known."""
    return {
        "schema": "boresight.comparison/1",
        "camera_model": comparison.compared[comparison.reference].camera_model,
        "reference": comparison.compared[comparison.reference].run.id,
        "assumption": ASSUMPTION,
        "runs": [
            {
                "id": one.run.id,
                "label": one.run.label,
                "state": one.run.state,
                "method": one.run.method,
                "shared_data": {"kind": shared.kind, "share": shared.share_a, "share_of_reference": shared.share_b},
                "sentence": sentence,
                "joint": joint(against),
            }
            for one, shared, sentence, against in zip(
                comparison.compared, comparison.shared, comparison.sentences, comparison.contrasts, strict=True
            )
        ],
        "parameters": [_row(comparison, i) for i in range(len(comparison.names))],
        "correlations": [{"names": [a, b], "values": values} for a, b, values in comparison.correlations()],
        "radial": [to_plain(one) for one in comparison.radial()],
    }


def joint(against: Contrast | None) -> dict[str, Any] | None:
    """Write the test of all parameters together."""
    if against is None or against.joint is None:
        return None
    statistic, dof, p = against.joint
    return {"chi2": statistic, "dof": dof, "p": p}


def _row(comparison: Comparison, i: int) -> dict[str, Any]:
    """Write one parameter: a list a run of value, sigma, difference, sigma of the difference, and their ratio."""
    name, found = comparison.names[i], comparison.compared

    def of(pick: str) -> list[float | None]:
        return [None if one is None else known_or_none(getattr(one, pick)[i]) for one in comparison.contrasts]

    return {
        "name": name,
        "values": [one.calibration.parameters.get(name) for one in found],
        "sigmas": [one.calibration.reliable_sigma.get(name) for one in found],
        "differences": of("difference"),
        "sigmas_of_difference": of("sigma"),
        "separations": of("separation"),
    }


def table(comparison: Comparison) -> dict[str, list[Any]]:
    """Lay the comparison of the parameters out as columns, one row a parameter and run, the reference's first."""
    order = sorted(range(len(comparison.compared)), key=lambda k: k != comparison.reference)
    rows = [(_row(comparison, i), k) for i in range(len(comparison.names)) for k in order]
    return {
        "parameter": [row["name"] for row, _ in rows],
        "run": [comparison.compared[k].run.id for _, k in rows],
        "reference": [comparison.compared[comparison.reference].run.id] * len(rows),
        "shared_data": [comparison.shared[k].kind for _, k in rows],
        **{one: [row[many][k] for row, k in rows] for one, many in COLUMNS.items()},
    }
