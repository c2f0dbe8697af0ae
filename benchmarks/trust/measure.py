"""What is told of data that contradict the model, and of data that do not (part `trust`).

Every set is calibrated by the library, `boresight.calibrate`, and judged by `boresight.assess` and its page's verdict. Told are

- `worst_sigma`: the largest error of a parameter over its claimed sigma, noise alone, median over the sets; `with_misfit` the same
  over the sigma that includes model error, where the calibration has one. `nees` is the mean of e^T P^-1 e with either covariance;
- `passes`: the share of sets that the fault makes wrong by more than 3 of the widest sigmas that they claim, while the clean set of
  the same seed is not, and on which every gate answers as for the clean set. None may where the fault can be seen, or where the
  gate of assumptions has data. It cannot be seen where the best test of two numbers would miss it more often than once in ten sets
  (`SEEN`);
- `first`, `causes`, `gates`: the advice that leads most often, the causes and gates that are no longer as for the clean set, with
  the share of sets.

A fault is **noticed** in a set when advice, a test, a cause, a removed star, a gate or the level of the verdict is there that the
clean set of the same seed has not (where only the geometry is poor: the clean set of the ST-16); a strength counts as noticed when
that holds in at least half of the sets. It **matters** from the strength on at which one of these is above 1:

    shift    the root mean square, over the sets, of the change of the worst parameter against the clean set's, in the clean sigma
    excess   sqrt(max(0, median NEES / NEES expected - 1)): what the errors are above the sigmas claimed, in those sigmas

Clean sets tell false advice, tests, causes and gates, the coverage of claimed intervals, and the error of batch and filter over
that of a maximum-likelihood fit with every attitude a nuisance (`benchmarks.efficiency`), in the metric of its information.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from scipy.stats import chi2

import boresight as bs
from benchmarks import Report, held
from benchmarks.efficiency import likelihood_fit
from benchmarks.trust.faults import CASES, FAULTS, Fault
from benchmarks.trust.scenes import ST16, Array, Scene, simulate
from benchmarks.trust.tables import case_table, clean_tables, fault_table, in_time
from boresight.calibration.trust.displacements import NINE_IN_TEN
from boresight.calibration.trust.fitted_set import UNLIKELY
from boresight.estimation.statistics.special import chdtri
from boresight.verdicts.verdict import LEVELS, make_verdict

STATUSES = ("PASS", "NO-DATA", "MARGINAL", "FAIL")
INTERVALS = (0.68, 0.95, 0.997)
#: Noncentrality from which on a test of two numbers, at the level that one of the family has, misses a fault once in ten.
SEEN = (np.sqrt(chdtri(2, UNLIKELY)) + NINE_IN_TEN) ** 2 - 1
#: In how many sigmas a set must be wrong for a gate to have to say so.
WRONG = 3.0
NUMBERS = re.compile(r"[-+−]?\d[\d.,  ]*(?:e[-+]?\d+)?")
METHODS: dict[str, dict[str, Any]] = {"batch": {}, "sqrf": {"method": "sqrf", "variant": "no-q"}}


@dataclass(frozen=True)
class Answer:
    """What the product made of a set; numbers are None where it refused or gave none.

    `error`, `P`, `P_misfit`: against the truth, SI. `advice`: sentences without their numbers, in order. `gates`: status by name.
    """

    status: str
    error: Array | None = None
    P: Array | None = None
    P_misfit: Array | None = None
    chi2_per_dof: float | None = None
    advice: tuple[str, ...] = ()
    tests: frozenset[str] = frozenset()
    causes: tuple[str, ...] = ()
    gates: Mapping[str, str] | None = None
    level: str = "critical"
    removed: int = 0

    @property
    def sigma(self) -> Array:
        """Claimed sigmas, of noise alone."""
        return np.sqrt(np.diag(self.P)) if self.P is not None else np.full(1, np.nan)

    def worst(self, *, misfit: bool = False) -> float:
        """Largest error over its sigma; infinite where there is no estimate."""
        P = self.P_misfit if misfit else self.P
        return np.inf if self.error is None or P is None else float(np.max(np.abs(self.error) / np.sqrt(np.diag(P))))

    def nees(self, *, misfit: bool = False) -> float:
        """Squared error in its covariance; infinite where there is no estimate."""
        P = self.P_misfit if misfit else self.P
        return np.inf if self.error is None or P is None else _square(self.error, P)


def _square(error: Array, P: Array) -> float:
    scale = np.sqrt(np.diag(P))
    return float((error / scale) @ np.linalg.solve(P / np.outer(scale, scale), error / scale))


def ask(scene: Scene, **settings: Any) -> Answer:
    """Calibrate and judge a set."""
    sensor = scene.optics.sensor()
    try:
        found = bs.calibrate(scene.telemetry(), sensor, progress=False, **{**scene.settings, **settings})
    except bs.RefusedInputError as refusal:
        return Answer("refused", advice=(NUMBERS.sub("#", str(refusal)),))
    try:
        gates = {gate.name: gate.status for gate in bs.assess(found, sensor, progress=False).gates}
    except bs.RefusedInputError:
        gates = {}
    said: dict[str, Any] = {
        "status": found.status, "chi2_per_dof": found.chi2_per_dof, "gates": gates, "level": make_verdict(found).level,
        "advice": tuple(NUMBERS.sub("#", sentence) for sentence in found.advice), "removed": len(found.removed or ()),
        "tests": frozenset(test.name for test in found.tests or () if test.noticed),
        "causes": tuple(cause.name for cause in found.causes or ()),
    }  # fmt: skip
    x = [found.parameters.get(name) for name in scene.optics.truth]
    if None in x or len(found.covariance.names) != len(x):
        return Answer(**said)
    P = np.asarray(found.covariance)
    misfit = None if found.misfit is None else np.asarray(found.misfit.covariance)
    known = np.all(np.isfinite(P)) and np.all(np.diag(P) > 0)
    return Answer(
        **said, error=np.array(x) - scene.optics.x if known else None, P=P if known else None, P_misfit=misfit
    )


def notices(answer: Answer, clean: Answer) -> dict[str, list[str]]:
    """What is told that the clean set's answer does not tell, by where."""
    worse = {
        name: status
        for name, status in (answer.gates or {}).items()
        if STATUSES.index(status) > STATUSES.index((clean.gates or {}).get(name, "PASS"))
    }
    found = {
        "advice": [sentence for sentence in answer.advice if sentence not in clean.advice],
        "tests": sorted(answer.tests - clean.tests),
        "causes": [cause for cause in answer.causes if cause not in clean.causes],
        "gates": [f"{name} {status}" for name, status in worse.items()],
        "verdict": [answer.level] if LEVELS.index(answer.level) > LEVELS.index(clean.level) else [],
        "removed": ["stars"] if answer.removed > clean.removed else [],
        "status": [answer.status] if answer.status not in {"converged", clean.status} else [],
    }
    return {where: told for where, told in found.items() if told}


def measure(
    report: Report, *, clean_sets: int = 1000, case_sets: int = 20, fault_sets: int = 8, frames: int = 100,
    names: tuple[str, ...] = (), first_seed: int = 0,
) -> dict[str, Any]:  # fmt: skip
    """Measure clean sets, the cases and the faults; `names` leaves out all other cases and faults."""
    clean = clean_table(clean_sets, frames, first_seed, lambda done, line: report(0.4 * done, line))
    chosen = [
        (fault, case_sets if fault in CASES else fault_sets)
        for fault in (*CASES, *FAULTS)
        if not names or fault.name in names
    ]
    rows: list[dict[str, Any]] = []
    for k, (fault, sets) in enumerate(chosen):
        report(0.4 + 0.6 * k / len(chosen), fault.says)
        rows += rows_of(fault, sets, frames, first_seed)
    known = {fault.name for fault in CASES}
    cases, faults = ([row for row in rows if (row["name"] in known) == wanted] for wanted in (True, False))
    return {
        "frames": frames, "case_sets": case_sets, "fault_sets": fault_sets, "clean": clean, "rows": rows,
        "limits": {**_clean_limits(clean), **_fault_limits(rows, faults)},
        "tables": {
            **({"clean": clean_tables(clean)} if clean else {}),
            **({"cases": case_table(cases)} if cases else {}),
            **({"faults": fault_table(faults)} if faults else {}),
        },
    }  # fmt: skip


def _clean_limits(clean: Mapping[str, Any]) -> dict[str, Any]:
    if not clean:
        return {}
    return {
        "clean sets with false advice": held(0.01, clean["false"]["advice"], "of the sets"),
        "clean sets with a gate that does not pass": held(0.01, clean["false"]["gates"], "of the sets"),
        **{
            f"{method}: error over the maximum-likelihood fit's": held(1.01, one["over_likelihood"])
            for method, one in clean["methods"].items()
        },
        **{
            f"{method}: NEES of {one['parameters']} off its mean": held(0.3, abs(one["nees"] - one["parameters"]))
            for method, one in clean["methods"].items()
        },
    }


def _fault_limits(rows: Sequence[dict[str, Any]], faults: Sequence[dict[str, Any]]) -> dict[str, Any]:
    unseen = [not row["visible"] or (row["noncentrality"] or SEEN) < SEEN for row in rows]
    asked = [row["assumptions"] == "NO-DATA" for row in rows]
    passing = max(
        (row["passes"] for row, *both in zip(rows, unseen, asked, strict=True) if not all(both)), default=None
    )
    limits = {
        "gates: sets wrong by more than 3 sigma that pass, though it can be seen or nothing is assumed": held(
            0.0, passing
        )
    }
    if faults:
        of_each = [list(group) for _, group in groupby(faults, lambda row: row["name"])]
        wanted = round(len(of_each) * 25 / 30)
        limits["faults noticed before they matter"] = held(wanted, sum(map(in_time, of_each)), at_least=True)
    return limits


def pairs(fault: Fault, strength: float, sets: int, frames: int, first_seed: int) -> Iterator[tuple[Answer, Answer]]:
    """Answers of sets with a fault and without."""
    for seed in range(first_seed, first_seed + sets):
        key, scene = _clean_scene(fault, frames, seed)
        wrong = fault.change(scene, strength, np.random.default_rng([61, seed]))
        if fault.of_geometry:
            key, scene = _clean_scene(replace(fault, optics=ST16, frames=None, exposures=2), frames, seed)
        key = (*key, *wrong.settings.items())
        if key not in _CLEAN:
            _CLEAN[key] = ask(scene, **wrong.settings)
        yield ask(wrong), _CLEAN[key]


#: Clean sets and their answers, for all faults that share them.
_SCENES: dict[Any, Scene] = {}
_CLEAN: dict[Any, Answer] = {}


def _clean_scene(fault: Fault, frames: int, seed: int) -> tuple[Any, Scene]:
    """Simulate the clean set of a fault; returns what it is known by besides."""
    optics, frames = fault.optics, fault.frames or frames
    key = (optics.camera, optics.noise_px, optics.window, optics.size, frames, fault.exposures, seed)
    if key not in _SCENES:
        _SCENES[key] = simulate(optics, frames, np.random.default_rng([16, seed]), fault.exposures)
    return key, _SCENES[key]


def rows_of(fault: Fault, sets: int, frames: int, first_seed: int) -> list[dict[str, Any]]:
    """Measure a fault, a row a strength."""
    said = {"name": fault.name, "says": fault.says, "unit": fault.unit, "visible": fault.visible, "sets": sets}
    return [
        {
            **said, "strength": strength, "noncentrality": noncentrality_of(fault, strength, frames, first_seed),
            **row_of(list(pairs(fault, strength, sets, frames, first_seed)), of_geometry=fault.of_geometry),
        }
        for strength in fault.strengths
        if sets
    ]  # fmt: skip


def row_of(answers: Sequence[tuple[Answer, Answer]], *, of_geometry: bool = False) -> dict[str, Any]:
    """What is told of the sets of one strength."""
    ours, told = [one for one, _ in answers], [notices(*pair) for pair in answers]
    shift, excess = 0.0 if of_geometry else shift_of(answers), excess_of(ours)
    noticed = float(np.mean([bool(one) for one in told]))
    misfit = [one for one in ours if one.P_misfit is not None]
    wrong = [min(one.worst(), one.worst(misfit=True)) > WRONG >= clean.worst() for one, clean in answers]
    passing = [bad and not {"gates", "status"} & one.keys() for bad, one in zip(wrong, told, strict=True)]
    return {
        "noticed": noticed >= 0.5, "matters": max(shift, excess) > 1, "noticed_share": noticed, "shift": shift, "excess": excess,
        "worst_sigma": _median(one.worst() for one in ours),
        "worst_sigma_with_misfit": _median(one.worst(misfit=True) for one in misfit),
        "nees": _mean(one.nees() for one in ours), "nees_with_misfit": _mean(one.nees(misfit=True) for one in misfit),
        "chi2_per_dof": _median(np.inf if one.chi2_per_dof is None else one.chi2_per_dof for one in ours),
        "passes": float(np.mean(passing)), "removed": _mean(one.removed for one in ours),
        "first": _most((one.advice[0] for one in ours if one.advice), len(ours)),
        "first_cause": _most((one.causes[0] for one in ours if one.causes), len(ours)),
        "level": _most((one.level for one in ours), len(ours)), "status": _most((one.status for one in ours), len(ours)),
        "assumptions": _most(((one.gates or {}).get("assumptions", "none") for one in ours), len(ours)),
        "where": _shares((where for one in told for where in one), len(ours)),
        **{key: _shares((name for one in told for name in one.get(key, ())), len(ours)) for key in ("tests", "causes", "gates")},
    }  # fmt: skip


def shift_of(answers: Sequence[tuple[Answer, Answer]]) -> float:
    """Root mean square change of the worst parameter, in sigmas of the clean set; infinite where an estimate fails."""
    changes = [
        None if one.error is None or clean.error is None else (one.error - clean.error) / clean.sigma
        for one, clean in answers
    ]
    if any(change is None for change in changes):
        return np.inf
    return float(np.sqrt(np.mean(np.square(np.array(changes)), axis=0)).max())


def excess_of(answers: Sequence[Answer]) -> float:
    """How far errors are above the claimed sigmas, in these."""
    n = max((len(one.error) for one in answers if one.error is not None), default=1)
    ratio = float(np.median([one.nees() for one in answers])) / float(chi2(n).median())
    return float(np.sqrt(max(0.0, ratio - 1)))


def _median(values: Iterable[float]) -> float | None:
    kept = list(values)
    return float(np.median(kept)) if kept else None


def _mean(values: Iterable[float]) -> float | None:
    kept = list(values)
    return float(np.mean(kept)) if kept else None


def _most(words: Iterable[str], sets: int) -> str:
    """The word that stands most often, with its share where not all sets have it."""
    found = Counter(words).most_common(1)
    return "" if not found else found[0][0] + (f" ({found[0][1] / sets:.0%})" if found[0][1] < sets else "")


def _shares(words: Iterable[str], sets: int) -> dict[str, float]:
    return {word: count / sets for word, count in Counter(words).most_common(8)}


def clean_table(sets: int, frames: int, first_seed: int, report: Report) -> dict[str, Any]:
    """What is told of clean sets, and the errors of batch and filter beside the maximum-likelihood fit's."""
    if not sets:
        return {}
    answers: dict[str, list[Answer]] = {name: [] for name in METHODS}
    squares: dict[str, list[float]] = {name: [] for name in (*METHODS, "likelihood")}
    for k in range(sets):
        report(k / sets, f"clean set {k + 1} of {sets}")
        scene = simulate(ST16, frames, np.random.default_rng([16, first_seed + k]))
        x, information, _ = fit_likelihood(scene)
        scale = 1 / np.sqrt(np.diag(information))
        A = information * np.outer(scale, scale)
        for name, settings in METHODS.items():
            answers[name].append(ask(scene, **settings))
            error = answers[name][-1].error
            squares[name].append(np.inf if error is None else float(error / scale @ A @ (error / scale)))
        squares["likelihood"].append(float((x - ST16.x) / scale @ A @ ((x - ST16.x) / scale)))
    batch = answers["batch"]
    return {
        "sets": sets, "likelihood_nees": float(np.mean(squares["likelihood"])), "false": false_alarms(batch),
        "false_advice": _shares((s for one in batch for s in one.advice), sets),
        "false_tests": _shares((s for one in batch for s in one.tests), sets),
        "false_causes": _shares((s for one in batch for s in one.causes), sets),
        "false_gates": _shares(
            (f"{n} {s}" for one in batch for n, s in (one.gates or {}).items() if s in {"MARGINAL", "FAIL"}), sets
        ),
        "no_data": sorted({n for one in batch for n, s in (one.gates or {}).items() if s == "NO-DATA"}),
        "levels": _shares((one.level for one in batch), sets),
        "methods": {name: method_row(answers[name], squares[name], squares["likelihood"]) for name in METHODS},
    }  # fmt: skip


def false_alarms(answers: Sequence[Answer]) -> dict[str, float]:
    """Share of clean sets on which something is held against them, by where."""
    return {
        "advice": float(np.mean([bool(one.advice) for one in answers])),
        "tests": float(np.mean([bool(one.tests) for one in answers])),
        "causes": float(np.mean([bool(one.causes) for one in answers])),
        "gates": float(np.mean([bool({"MARGINAL", "FAIL"} & set((one.gates or {}).values())) for one in answers])),
        "verdict": float(np.mean([one.level != "normal" for one in answers])),
        "removed": float(np.mean([one.removed > 0 for one in answers])),
    }


def method_row(answers: Sequence[Answer], square: Sequence[float], likelihood: Sequence[float]) -> dict[str, Any]:
    """Coverage, consistency and efficiency of one method on clean sets; the ratio with its 95 % interval by bootstrap."""
    z = np.array([one.error / one.sigma for one in answers if one.error is not None])
    drawn = np.random.default_rng(1).integers(0, len(square), (2000, len(square)))
    ours, best = np.array(square), np.array(likelihood)
    over = ours[drawn].mean(axis=1) / best[drawn].mean(axis=1)
    misfit = [one.nees(misfit=True) for one in answers if one.P_misfit is not None]
    return {
        "parameters": z.shape[1],
        "coverage": {f"{p:.1%}": float(np.mean(np.square(z) < chi2(1).ppf(p))) for p in INTERVALS},
        "nees": float(np.mean([one.nees() for one in answers])),
        "nees_sigma": float(np.sqrt(2 * z.shape[1] / len(answers))),
        "nees_with_misfit": _mean(misfit),
        "over_likelihood": float(ours.mean() / best.mean()),
        "over_likelihood_interval": np.quantile(over, (0.025, 0.975)).tolist(),
    }


@dataclass(frozen=True)
class _Centroids:
    """A scene as the maximum-likelihood fit takes it, its attitudes known nearly."""

    n_exposures: int
    star_start: Any
    s_i: Array
    sigma_px: Array
    row_px: Array
    col_px: Array


def fit_likelihood(scene: Scene) -> tuple[Array, Array, float]:
    """Maximum-likelihood parameters of a scene with the directions that it tells, their information, and chi-square."""
    starts = np.flatnonzero(np.diff(scene.exposure_of, prepend=-1, append=-1))
    row, col = np.ascontiguousarray(scene.measured_px().T)
    ra, dec = (np.radians(scene.told_directions(name)) for name in ("ra_deg", "dec_deg"))
    s_i = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    s = np.einsum("nij,nj->ni", scene.attitude[scene.exposure_of], s_i)
    sigma = np.full(scene.n, scene.optics.noise_px)
    stars = _Centroids(len(starts) - 1, starts, s, sigma, row, col)
    return likelihood_fit(scene.optics.forward, stars, scene.optics.x.copy())


def noncentrality_of(fault: Fault, strength: float, frames: int, seed: int) -> float | None:
    """Chi-square of the faulty set without noise, when parameters and attitudes have adapted; None where none is told."""
    _, scene = _clean_scene(fault, frames, seed)
    quiet = replace(scene, noise_px=np.zeros_like(scene.noise_px))
    try:
        wrong = fault.change(quiet, strength, np.random.default_rng([61, seed]))
        left = None if "ra_deg" in wrong.told and wrong.told["ra_deg"] is None else fit_likelihood(wrong)[2]
    except np.linalg.LinAlgError:
        return None
    return left if left is not None and np.isfinite(left) else None
