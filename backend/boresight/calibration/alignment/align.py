"""An alignment from its two sides: pairs, estimate, and the result in arcseconds with its advice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, BoolArray, FloatArray, IntArray, list_known
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.alignment.result import (
    AXES,
    AlignedSide,
    Alignment,
    AlignmentTerm,
    AlignmentTermTest,
    PairResiduals,
    PairTest,
    RemovedPair,
    RotationToLoad,
    write_quaternion,
)
from boresight.calibration.alignment.sides import Side, write_time
from boresight.errors import RefusedInputError
from boresight.estimation.alignment import (
    HIGHEST_POWER,
    Estimate,
    Fit,
    PairingRule,
    Pairs,
    Term,
    Variation,
    estimate,
    exp_rotation,
    make_pairs,
    make_variation,
)
from boresight.estimation.statistics.special import chdtri

#: Pairs whose residuals are kept, evenly spread, beside those that were removed; and removed ones that are listed.
MOST_RESIDUALS, MOST_REMOVED = 2000, 200

#: Difference of two clocks that is easily overlooked, s.
UNSEEN_S = 0.1

TemperatureOf = Literal["a", "b", "difference"]
TEMPERATURES: tuple[TemperatureOf, ...] = ("a", "b", "difference")


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions:
    """The choices of an alignment.

    `tolerance_s`: how far an attitude may be carried beyond its neighbours. `longest_gap_s`: between two that are interpolated.
    `rate_deg_s`: one sigma of a rate that no neighbour tells. `temperature_of`: whose temperature counts; left out, A's where it is
    known, else B's. `reference_temperature_c`: where the rotation is told, else at the mean. `temperature`: highest power of the
    temperature, 0 for none. `drift`: a change a day, or none. Evidence chooses where neither is said; where one is, the other is
    none. `robust`: leave out pairs that are too far off.
    """

    tolerance_s: float = 0.5
    longest_gap_s: float = 10.0
    rate_deg_s: float = 0.1
    temperature_of: TemperatureOf | None = None
    reference_temperature_c: float | None = None
    temperature: int | None = None
    drift: bool | None = None
    robust: bool = True

    def __post_init__(self) -> None:
        """Refuse choices that make no sense, naming the first."""
        limits = {
            "tolerance_s": (0.0, 60.0),
            "longest_gap_s": (0.0, 3600.0),
            "rate_deg_s": (0.0, 100.0),
            "reference_temperature_c": (-273.15, 400.0),
            "temperature": (0, HIGHEST_POWER + 1),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise RefusedInputError(f"{name} is {value:g}: choose {low:g} to {high:g}.")
        if self.temperature_of not in {None, *TEMPERATURES}:
            raise RefusedInputError(f"temperature_of is {self.temperature_of!r}: choose {', '.join(TEMPERATURES)}.")

    @property
    def rule(self) -> PairingRule:
        """How attitudes are paired."""
        return PairingRule(self.tolerance_s, self.longest_gap_s, float(np.radians(self.rate_deg_s)))

    def choose_terms(self) -> tuple[Term, ...] | None:
        """Return the terms that were asked for; None where evidence chooses."""
        if self.temperature is None and self.drift is None:
            return None
        powers = tuple(Term("temperature", power) for power in range(1, (self.temperature or 0) + 1))
        return powers + ((Term("time", 1),) if self.drift else ())


def align_sides(a: Side, b: Side, options: AlignmentOptions = AlignmentOptions()) -> Alignment:
    """Estimate the rotation from A to B; refuses sides that were never looked at together."""
    pairs = make_pairs(a.series, b.series, options.rule)
    if not len(pairs):
        raise RefusedInputError(_never(a, b, options))
    which, warmth = _temperature(pairs, options)
    variation = make_variation(pairs, warmth, options.reference_temperature_c)
    wanted = options.choose_terms()
    if wanted and not _can_have(variation, wanted):
        raise RefusedInputError(
            f"{len(pairs)} pairs cannot determine the requested terms: temperature or time is unknown or barely changes. "
            "Omit the terms, or give a longer set."
        )
    found = estimate(pairs, variation, wanted=wanted, robust=options.robust)
    return _write(a, b, pairs, variation, which, found)


def _can_have(variation: Variation, wanted: tuple[Term, ...]) -> bool:
    return all(variation.can_tell(term, wanted[:place]) for place, term in enumerate(wanted))


def _never(a: Side, b: Side, options: AlignmentOptions) -> str:
    spans = [
        f"{one.name} from {write_time(one.series.time_s[0])} to {write_time(one.series.time_s[-1])}" for one in (a, b)
    ]
    return (
        f"No attitudes of the two frames are at the same time within {options.tolerance_s:g} s: {' and '.join(spans)}. Give sets "
        "of the same hours, or allow a longer tolerance or gap."
    )


def _temperature(pairs: Pairs, options: AlignmentOptions) -> tuple[TemperatureOf | None, FloatArray]:
    """Whose temperature the rotation may depend on, and it (K,)."""
    of_a, of_b = pairs.temperature_c.T
    which = options.temperature_of
    if which is None:
        which = "a" if np.isfinite(of_a).all() else "b" if np.isfinite(of_b).all() else None
    value = {"a": of_a, "b": of_b, "difference": of_a - of_b, None: np.full(len(pairs), np.nan)}[which]
    return which if np.isfinite(value).any() else None, value


def _write(
    a: Side, b: Side, pairs: Pairs, variation: Variation, which: TemperatureOf | None, found: Estimate
) -> Alignment:
    fit = found.fit
    P = fit.covariance_with_misfit
    known = variation.temperature_c[np.isfinite(variation.temperature_c)]
    bounds = None if fit.dof < 1 else [float(chdtri(fit.dof, p)) / fit.dof for p in (0.975, 0.025)]
    return Alignment(
        a=_describe_side(a),
        b=_describe_side(b),
        quaternion=write_quaternion(fit.M),
        matrix=[[float(one) for one in row] for row in fit.M],
        sigma_arcsec=_sigmas(fit.covariance)[:3],
        sigma_with_misfit_arcsec=_sigmas(P)[:3],
        covariance_rad2=[[float(one) for one in row] for row in P],
        to_load=_to_load(fit),
        reference_temperature_c=variation.reference_c if len(known) else None,
        temperature_of=which,
        temperature_range_c=[float(known.min()), float(known.max())] if len(known) else None,
        reference_utc=write_time(variation.middle_s),
        terms=[
            _term(term, fit.beta[place], _sigmas(P)[3 * place : 3 * place + 3])
            for place, term in enumerate(fit.terms, 1)
        ],
        tests=[AlignmentTermTest(name=one.term.name, fall=one.fall, p=one.p, needed=one.needed) for one in found.tests],
        pairs=len(pairs),
        pairs_used=int(found.keep.sum()),
        interpolated=int((pairs.offset_s > 0).sum()),
        test=PairTest(
            chi2=fit.chi2,
            dof=fit.dof,
            ratio=fit.ratio if fit.dof > 0 else None,
            lower=None if bounds is None else bounds[0],
            upper=None if bounds is None else bounds[1],
        ),
        removed=_removed(a, b, pairs, found),
        residuals=_residuals(pairs, variation, found),
        sentence=_sentence(a, b, found, P),
        advice=list(_advice(a, b, found)),
    )


def _to_load(fit: Fit) -> RotationToLoad:
    """Return the rotation for whoever loads these parameters, widened by the scatter of the pairs."""
    M = exp_rotation(fit.load[0]) @ fit.M
    P = fit.covariance_to_load + max(fit.ratio - 1.0, 0.0) * fit.covariance_of_noise
    return RotationToLoad(
        quaternion=write_quaternion(M),
        matrix=[[float(one) for one in row] for row in M],
        sigma_arcsec=_sigmas(P)[:3],
        covariance_rad2=[[float(one) for one in row] for row in P],
        terms_arcsec=((fit.beta + fit.load)[1:] * ARCSEC_PER_RAD).tolist(),
    )


def _sigmas(P: FloatArray) -> list[float]:
    return [float(one) for one in np.sqrt(np.diag(P)) * ARCSEC_PER_RAD]


def _advice_on_clocks(a: Side, b: Side, found: Estimate) -> Iterator[Advice]:
    """Say by how much the clocks differ, or what a difference that nothing tells would do."""
    clock = found.clock
    if clock is not None and clock.needed:
        yield Advice(
            f"The time stamps of {b.name} are {clock.offset_s:+.3g} ± {clock.sigma_s:.2g} s later than those of {a.name}, because "
            "the pairs differ in proportion to the rate. Correct them and align again: under a steady turn this offset is hidden "
            "in the rotation.",
            "alignment_clock",
        )
    elif clock is not None and clock.steady_rad_s * min(3 * clock.sigma_s, UNSEEN_S) > 3 * max(_known_rad(found.fit)):
        rate = clock.steady_rad_s * ARCSEC_PER_RAD
        yield Advice(
            f"The body turned steadily at {rate:.3g} arcsec/s: a clock offset of {UNSEEN_S:g} s would change the rotation by "
            f"{UNSEEN_S * rate:.3g} arcsec without being visible in the data. Make sure that both trackers use the same clock, or "
            "include turns about other axes.",
            "alignment_clock",
        )


def _known_rad(fit: Fit) -> FloatArray:
    """One sigma of the rotation to load about each axis of B, rad."""
    return np.asarray(np.sqrt(np.diag(fit.covariance_to_load)[:3]))


def _describe_side(side: Side) -> AlignedSide:
    return AlignedSide(
        name=side.name,
        parameters=side.parameters,
        values=side.values,
        exposures=side.exposures,
        attitudes=len(side.series),
        start_utc=write_time(side.series.time_s[0]),
        end_utc=write_time(side.series.time_s[-1]),
    )


def _term(term: Term, beta: FloatArray, sigma: list[float]) -> AlignmentTerm:
    unit = "day" if term.kind == "time" else "°C" if term.power == 1 else f"°C^{term.power}"
    value = [float(one) for one in beta * ARCSEC_PER_RAD]
    return AlignmentTerm(
        name=term.name, kind=term.kind, power=term.power, unit=unit, value_arcsec=value, sigma_arcsec=sigma
    )


def _removed(a: Side, b: Side, pairs: Pairs, found: Estimate) -> list[RemovedPair]:
    """The pairs that were left out, least likely first."""
    out = np.flatnonzero(~found.keep)
    listed = out[np.argsort(-found.fit.pair_chi2[out], kind="stable")][:MOST_REMOVED]
    return [
        RemovedPair(
            time_utc=write_time(pairs.time_s[k]),
            frame_a=_number(a.frame, pairs.place[k, 0]),
            exposure_a=_number(a.exposure, pairs.place[k, 0]),
            frame_b=_number(b.frame, pairs.place[k, 1]),
            exposure_b=_number(b.exposure, pairs.place[k, 1]),
            angle_arcsec=float(np.linalg.norm(found.fit.residual[k]) * ARCSEC_PER_RAD),
            chi2=float(found.fit.pair_chi2[k]),
            probability=float(found.probability[k]),
        )
        for k in listed
    ]


def _number(numbers: IntArray, place: int) -> int | None:
    return None if numbers[place] < 0 else int(numbers[place])


def _residuals(pairs: Pairs, variation: Variation, found: Estimate) -> PairResiduals:
    fit = found.fit
    some = np.flatnonzero(_select_residuals(found.keep))
    sigma = np.sqrt(np.einsum("kii->ki", pairs.R)[some]) * ARCSEC_PER_RAD
    left = fit.residual - pairs.G @ fit.shared
    basis = variation.basis(fit.terms)[some, 1:]
    warmth = variation.temperature_c[some]
    return PairResiduals(
        time_utc=[write_time(one) for one in pairs.time_s[some]],
        temperature_c=list_known(warmth),
        residual_arcsec=(left[some] * ARCSEC_PER_RAD).tolist(),
        sigma_arcsec=sigma.tolist(),
        variation_arcsec=(basis @ fit.beta[1:] * ARCSEC_PER_RAD).tolist(),
        probability=found.probability[some].tolist(),
        kept=found.keep[some].tolist(),
    )


def _select_residuals(keep: BoolArray) -> BoolArray:
    """Which residuals are kept: all of few; of many evenly spread ones, and those that were removed first."""
    if len(keep) <= MOST_RESIDUALS:
        return np.ones(len(keep), np.bool_)
    shown = np.zeros(len(keep), np.bool_)
    shown[np.linspace(0, len(keep) - 1, MOST_RESIDUALS - MOST_REMOVED).astype(np.int64)] = True
    shown[np.flatnonzero(~keep)[:MOST_REMOVED]] = True
    return shown


def _sentence(a: Side, b: Side, found: Estimate, P: FloatArray) -> str:
    """Answer first: how well the rotation is known, to load and of the body, and what it depends on."""
    load = _to_load(found.fit).sigma_arcsec
    known = ", ".join(f"{axis} ± {3 * value:.3g}" for axis, value in zip(AXES, load, strict=True))
    body = ", ".join(f"{axis} ± {3 * value:.3g}" for axis, value in zip(AXES, _sigmas(P)[:3], strict=True))
    words = (
        f"The rotation from {a.name} to {b.name} is known from {found.keep.sum():,} pairs to {known} arcsec (3 sigma) if loaded "
        f"with these parameters, and to {body} arcsec between the frames themselves, including the cameras' errors"
    )
    depends = [
        f"{'temperature' if term.kind == 'temperature' else 'time'}, {np.linalg.norm(found.fit.beta[place]) * ARCSEC_PER_RAD:.3g} "
        f"arcsec per {'day' if term.kind == 'time' else 'degree' if term.power == 1 else f'degree to the power of {term.power}'}"
        for place, term in enumerate(found.fit.terms, 1)
    ]
    with_terms = f"; it depends on {', and on '.join(depends)}" if depends else ""
    return f"{words}{with_terms}."


def _advice(a: Side, b: Side, found: Estimate) -> Iterator[Advice]:
    """Say what to know and do."""
    for side in (a, b):
        if side.parameters == "typical":
            yield Advice(
                f"No calibration of {side.name} was given, so its camera is assumed to have the typical spread. Give one to "
                "reduce the sigmas.",
                "alignment_parameters",
            )
        if side.parameters == "none":
            yield Advice(
                f"The parameters of {side.name} have no covariance, so its share is missing in the sigmas: give a calibration.",
                "alignment_covariance",
            )
    removed = int((~found.keep).sum())
    if removed:
        yield Advice(
            f"{removed:,} of {len(found.keep):,} pairs were left out as too far off: look at their times and frames; matches, time "
            "stamps or a fast turn cause that.",
            "alignment_removed",
        )
    fit = found.fit
    if fit.dof > 0 and fit.ratio > float(chdtri(fit.dof, 0.025)) / fit.dof:
        yield Advice(
            f"The scatter of the pairs is {np.sqrt(fit.ratio):.3g} times that expected from the stars and the reference, so the "
            "sigmas were widened: check time stamps, the reference's sigma, and jitter between the frames.",
            "alignment_scatter",
        )
    yield from _advice_on_clocks(a, b, found)
    names = {one.term.kind for one in found.tests}
    if "temperature" not in names and not any(one.kind == "temperature" for one in fit.terms):
        yield Advice(
            "Temperature is unknown or barely changed, so its effect cannot be determined: include passes at other temperatures.",
            "alignment_temperature",
        )
