"""What a whole calibration costs beside the fit alone in C: from a Parquet file to the calibration JSON (part `whole`).

The set is synthetic and of catalogue stars: two exposures of twelve named stars a frame, with times and without directions, so
that the sky is part of the work. The process is warm, as a worker's is: kernels compiled, catalogue loaded, one calibration
done; it computes on as many threads as a command does, `threads`, and once more on one, `one_thread_s`. Steps are told apart
where the calibration does so itself (`timing_s`), and the first of them once more by hand::

    reading       file to arrays, every check
    arcs          of which sky (directions from the catalogue) and ordering (which stars, and in what order)
    fit           of which R (both weighings); the rest are the evaluations and the steps
    judging       flight scores, shadow, alignment, observability, trust
    writing       the document as JSON

The peer is the same Levenberg-Marquardt run in C on one thread: as many evaluations of A and b as the fit took, by
`arclengths.c` (gcc -O3 -march=native), and nothing else: R, reading and all that follows are not counted for it, which is the
stricter way. The calibration whitens twice and so fits twice; its evaluations are counted over both, which is what the fit costs,
and over the first by itself, which is what one fit of given weights costs, `over_one_weighing` is the whole over that. With
`rematch`, the default of the command, the stars are found again at every cycle; that is told beside the same fit in C, which does
not know of it, and held against nothing.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import orjson

from benchmarks import Report, held
from benchmarks.kernels import fastest
from benchmarks.peers import compiled
from benchmarks.stars import repeated_fields
from boresight.calibration.calibrate import calibrate, select_free_parameters
from boresight.calibration.matching.matched_frames import read_given_matches
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, make_problem_of_directions
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.blocks import computing_on
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.writing import write_parquet

LIMIT = 12.0
#: How long sets of so many frames may take in a running process.
SMALL_FRAMES, SMALL_LIMIT_S, LARGE_FRAMES, LARGE_LIMIT_S = 200, 0.06, 20_000, 0.9
#: The limit holds for a set of this size or more; of small ones the constants are told.
LIMIT_FROM_FRAMES = 20_000
REPEATS = 3


def measure(
    report: Report, *, frames: int = 20_000, small_frames: int = 200, rematch: bool = True, seed: int = 1
) -> dict[str, Any]:
    """Calibrate a file whole, a small one as thousands go through the queue, and fit the same arcs in C."""
    sensor, catalogue = st16_sensor(1), load_catalogue(read_settings().catalogue_folder)
    found: dict[str, Any] = {"frames": frames, "stars_per_exposure": 12, "exposures_per_frame": 2}
    with tempfile.TemporaryDirectory(prefix="boresight-whole-") as folder:
        for share, name, size in ((0.0, "given", frames), (0.5, "small", small_frames)):
            report(share, f"drawing {size:,} frames")
            path = Path(folder) / f"{name}.parquet"
            write_parquet(repeated_fields(size, sensor, catalogue, seed), path)
            report(share + 0.1, f"calibrating {size:,} frames")
            found[name] = _given(path, sensor, catalogue) | {"frames": size}
        if rematch:
            report(0.7, f"calibrating {frames:,} frames, matched again")
            whole = CalibrationSettings(match="rematch")
            found["rematch"] = _whole(Path(folder) / "given.parquet", sensor, catalogue, whole, repeats=1)
            if "c_fit_s" in found["given"]:
                found["rematch"]["over_c_fit"] = found["rematch"]["total_s"] / found["given"]["c_fit_s"]
    limit = held(LIMIT, found["given"].get("over_c_fit"))
    found["limits"] = {"over_c_fit": limit if frames >= LIMIT_FROM_FRAMES else limit | {"kept": None}}
    if small_frames == SMALL_FRAMES:
        found["limits"]["small_set"] = held(SMALL_LIMIT_S, found["small"]["total_s"], "s")
    if frames == LARGE_FRAMES:
        found["limits"]["large_set"] = held(LARGE_LIMIT_S, found["given"]["total_s"], "s")
    report(1.0, "done")
    return found


def _given(path: Path, sensor: Sensor, catalogue: Catalogue) -> dict[str, Any]:
    """Calibrate with the matches of the file, step by step, and fit the same arcs in C."""
    settings = CalibrationSettings(match="given")
    found = _whole(path, sensor, catalogue, settings, repeats=REPEATS)
    found["one_thread_s"] = _whole(path, sensor, catalogue, settings, repeats=1, threads=1)["total_s"]
    telemetry = read_telemetry(path)
    matches = read_given_matches(telemetry, sensor, catalogue)
    problem = make_problem_of_directions(telemetry, sensor, matches.s_i, settings.minimum_stars)
    x, scale = sensor.initial, sensor.typical_sigma
    with computing_on(read_settings().computing_threads):
        works: dict[str, Callable[[], object]] = {
            "sky": lambda: read_given_matches(telemetry, sensor, catalogue),
            "ordering": lambda: make_problem_of_directions(telemetry, sensor, matches.s_i, settings.minimum_stars),
            "R_of_both_weighings": lambda: replace(problem).whitened(x),
        }
        found["of_which_s"] = {name: fastest(work, repeats=REPEATS)[0] for name, work in works.items()}
        found["of_which_s"]["R_of_both_weighings"] *= 2
    arcs, (first, second) = problem.whitened(x).whole(), _evaluations(problem, sensor, settings)
    found |= {"evaluations": first + second, "evaluations_of_one_weighing": first}
    with compiled() as peers:
        if "c" in peers:
            evaluation = fastest(lambda: peers["c"].normal_equations(arcs, x, scale), repeats=REPEATS)[0]
            found["c_evaluation_s"], found["c_fit_s"] = evaluation, (first + second) * evaluation
            found["over_c_fit"] = found["total_s"] / found["c_fit_s"]
            found["over_one_weighing"] = found["total_s"] / (first * evaluation)
    return found


def _evaluations(problem: Problem, sensor: Sensor, settings: CalibrationSettings) -> tuple[int, int]:
    """Count the evaluations of A and b in the two fits of a calibration, those of refused steps too."""
    x, counts, parameters = sensor.initial, list[int](), select_free_parameters(sensor, settings)
    for _ in range(2):
        counted = _Counted(problem.whitened(x).whole())
        x = batch.fit(
            cast("ArcSet", counted), x, parameters.free, parameters.scale, max_iterations=settings.max_iterations
        ).x
        counts.append(counted.passes)
    return counts[0], counts[1]


class _Counted:
    """Arcs that count how often they are passed over, for `batch.fit`."""

    def __init__(self, arcs: ArcSet) -> None:
        self._arcs = arcs
        self.passes = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._arcs, name)

    def over_blocks(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Count the pass and make it."""
        self.passes += 1
        return self._arcs.over_blocks(function, *arguments)


def _whole(
    path: Path, sensor: Sensor, catalogue: Catalogue, settings: CalibrationSettings, repeats: int, threads: int = 0
) -> dict[str, Any]:
    """Time the whole in a warm process: the fastest of some runs, after one that is not counted, with its steps.

    `threads` 0 is as many as a command has.
    """
    threads = threads or read_settings().computing_threads
    with computing_on(threads):
        runs = [_once(path, sensor, catalogue, settings) for _ in range(1 + repeats)]
    return min(runs[1:], key=lambda run: float(run["total_s"])) | {"threads": threads}


def _once(path: Path, sensor: Sensor, catalogue: Catalogue, settings: CalibrationSettings) -> dict[str, Any]:
    began = time.perf_counter()
    telemetry = read_telemetry(path)
    read = time.perf_counter()
    document = calibrate(telemetry, sensor, catalogue, settings).to_dict()
    done = time.perf_counter()
    path.with_suffix(".json").write_bytes(orjson.dumps(document))
    ended = time.perf_counter()
    laps = document["timing_s"]
    return {
        "total_s": ended - began,
        "steps_s": {
            "reading": read - began,
            "arcs": laps["arcs"],
            "fit": laps["fit"],
            "judging": laps["judge"],
            "writing": ended - done,
        },
        "status": document["status"],
    }
