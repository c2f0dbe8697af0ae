"""The least candidate of each camera that suffices, and the least of all cameras.

Within a camera every subset of its terms is a candidate. One *suffices* where no larger one that contains it, and whose parameters
the stars determine, is better by a test (`nested_tests`). Its terms are *needed* where without any one of them it would not
suffice, by the test between the two. Of the candidates that suffice and whose terms are needed (where there are none, of those
that suffice) the one with the fewest parameters is taken, of equals the one whose terms come first in the camera's order: the
plainer word, such as tilt for tangential terms, which do the same where both are small. None of them holds another. So the rule is
that of cameras of which neither holds the other, below: the plainer one gives way where its BIC is above another's by T.
A right candidate is rejected with a chance of at most the level over all cameras, and only then, or where a term of its own is too
weak for the tests, is another taken.

Between cameras the sensor's own stays unless the stars speak against it, for to change it is the largest change of all. Where
another holds it (the same terms give the same chi-square: `brown_conrady` every `pinhole_radial`), they speak by the same test.
Else by BIC = chi2 / s^2 + k ln n with k free parameters and n arcs (Schwarz 1978); s is 1 while the stated noise holds. How far may
a false camera come out ahead of a true one by noise? With d the chi-square that the false one's misfit adds, the difference is
normal with mean d and variance 4 d, so that it is below -T with the chance Phi(-(T + d) / (2 sqrt(d))), which is largest at d = T,
and there Phi(-sqrt(T)). With five cameras T = 7.88 therefore keeps that at the level for the four others together, whatever the
misfit: the sensor's camera is out when another's BIC, in which it is not charged for parameters that it needs more, is lower by
more than T. For the sensor's camera speaks the best of its candidates that the stars determine, not the least: a term that is too
weak for the tests may well cost more than T, and another camera would take its place though the lens is the sensor's. Next comes a
camera that holds it, by the same rule; then the one with the lowest BIC, and of those that are alike the one with the fewest
parameters in all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from scipy.special import ndtri

from boresight.calibration.choice.fits import Fits, FittedSubset
from boresight.calibration.choice.nested_tests import (
    LEVEL,
    NestedTest,
    Noise,
    count_tests,
    critical_drop,
    nested_test,
)
from boresight.calibration.choice.result import ALIKE, State
from boresight.calibration.choice.terms import Subset, base, find_terms, largest
from boresight.calibration.estimate import never
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.estimation.arcs import ArcSet
from boresight.telemetry.sensors import Sensor

#: Difference of BIC from which the sensor's camera is out, and of chi-square from which a plainer term is, see above.
DECISIVE = float(ndtri(LEVEL / max(1, len(CAMERA_MODELS) - 1))) ** 2
#: How many times the drop at which a test rejects the linearised rise must be for a candidate not to be fitted.
HOPELESS = 10.0


@dataclass(frozen=True)
class CameraChoice:
    """The least candidate of one camera that suffices.

    `fitted`: it. `needed`: the test of each of its terms, against the candidate without it. `beyond`: the test of each term that it
    does not have, and of all of them.
    """

    fitted: FittedSubset
    needed: tuple[NestedTest, ...]
    beyond: tuple[NestedTest, ...]


def fit_ladders(
    arcs: ArcSet, sensor: Sensor, cancelled: Callable[[], bool] = never
) -> tuple[Fits, FittedSubset | None]:
    """Fit every camera with one term more at a time, in its order; returns all fits, and the richest camera's with all terms free.

    The richest is the one with the least chi-square per degree of freedom; None where none could be fitted.
    """
    fits = Fits(arcs, sensor, cancelled)
    ended: list[FittedSubset] = []
    for camera in CAMERA_MODELS.values():
        fits.fit(base(camera))
        for count in range(len(find_terms(camera))):
            fits.fit(Subset(camera, find_terms(camera)[: count + 1]))
        full = fits.fit(largest(camera))
        if full.state is not State.FAILED and full.dof > 0:
            ended.append(full)
    return fits, min(ended, key=lambda one: one.chi2 / one.dof, default=None)


@dataclass(frozen=True)
class LeastModel:
    """What a search found: the noise that it tested by, the chosen candidate, and the other cameras' beside it."""

    noise: Noise
    chosen: CameraChoice
    between: tuple[Between, ...]


def find_least(fits: Fits, richest: FittedSubset) -> LeastModel | None:
    """Find the least candidate of all cameras that suffices; None where no camera has one."""
    noise = Noise(richest.chi2 / richest.dof, richest.dof)
    found = [choose_of_camera(fits, camera, noise, len(CAMERA_MODELS)) for camera in CAMERA_MODELS.values()]
    choices = [one for one in found if one is not None]
    if not choices:
        return None
    chosen, between = choose_camera(choices, fits, noise, fits.sensor.camera_model)
    return LeastModel(noise, chosen, tuple(between))


def choose_of_camera(fits: Fits, camera: CameraModel, noise: Noise, cameras: int) -> CameraChoice | None:
    """Find the least candidate of a camera that suffices; None where none could be fitted."""

    def rejects(smaller: FittedSubset, larger: FittedSubset) -> bool:
        return smaller.chi2 - larger.chi2 > _critical(smaller.subset, larger.subset, noise, cameras)

    def hopeless(smaller: Subset, larger: Subset, rise: float) -> bool:
        return rise > HOPELESS * _critical(smaller, larger, noise, cameras)

    fits.fit_all(camera, hopeless)
    usable = [one for one in fits.list_fitted(camera) if one.usable]
    sufficient = [
        one
        for one in usable
        if not any(rejects(one, other) for other in usable if other is not one and other.subset.contains(one.subset))
    ]
    if not sufficient:
        return None
    out = [one for one in fits.list_fitted(camera) if one.usable or one.state is State.REJECTED]
    of_terms = {one.subset.term_names: one for one in out}

    def has_needed_terms(one: FittedSubset) -> bool:
        without = (of_terms.get(one.subset.without_term(term).term_names) for term in one.subset.removable())
        return all(smaller is None or not smaller.usable or rejects(smaller, one) for smaller in without)

    here = _plainest([one for one in sufficient if has_needed_terms(one)] or sufficient, noise)
    return CameraChoice(here, _needed(fits, here, noise, cameras), _beyond(fits, here, noise, cameras))


def _critical(smaller: Subset, larger: Subset, noise: Noise, cameras: int) -> float:
    """Drop of chi-square between two candidates of a camera from which the smaller is rejected."""
    looked_at = count_tests(smaller, terms=len(larger.terms) - len(smaller.terms)) * cameras
    return critical_drop(noise, len(larger.free) - len(smaller.free), looked_at)


def _plainest(candidates: list[FittedSubset], noise: Noise) -> FittedSubset:
    """Return the candidate with the fewest parameters, of equals that of the earliest terms, unless BIC decides against it."""
    order = [term.name for term in find_terms(candidates[0].camera)]
    by_size = sorted(candidates, key=lambda one: (one.n_free, [order.index(name) for name in one.subset.term_names]))
    lowest = min(bic(one, noise) for one in candidates)
    return next(one for one in by_size if bic(one, noise) <= lowest + DECISIVE)


def _beyond(fits: Fits, here: FittedSubset, noise: Noise, cameras: int) -> tuple[NestedTest, ...]:
    """Test every term that may come next, and all at once."""
    larger = [fits.fit(here.subset.with_term(term)) for term in here.subset.extensions()]
    full = fits.fit(largest(here.camera))
    if len(full.subset.terms) > len(here.subset.terms) + 1:
        larger.append(full)
    return tuple(_test(here, one, noise, cameras) for one in larger if one.state is not State.FAILED)


def _needed(fits: Fits, here: FittedSubset, noise: Noise, cameras: int) -> tuple[NestedTest, ...]:
    """Test every term that may be held again."""
    smaller = [fits.fit(here.subset.without_term(term)) for term in here.subset.removable()]
    return tuple(_test(one, here, noise, cameras) for one in smaller if one.state is not State.FAILED)


def _test(smaller: FittedSubset, larger: FittedSubset, noise: Noise, cameras: int) -> NestedTest:
    terms = len(larger.subset.terms) - len(smaller.subset.terms)
    return nested_test(smaller, larger, noise, count_tests(smaller.subset, terms=terms) * cameras)


@dataclass(frozen=True)
class Between:
    """A camera's candidate against the chosen one: by a nested test where one holds the other, else by BIC."""

    against: CameraChoice
    bic_above: float
    test: NestedTest | None


def bic(fitted: FittedSubset, noise: Noise) -> float:
    """Schwarz's criterion, with the noise that was found."""
    return fitted.chi2 / noise.scale + fitted.n_free * math.log(fitted.dof + fitted.n_free)


def choose_camera(
    choices: list[CameraChoice], fits: Fits, noise: Noise, own: str
) -> tuple[CameraChoice, list[Between]]:
    """Choose between the cameras' candidates."""
    lowest = min(bic(one.fitted, noise) for one in choices)
    alike = [one for one in choices if bic(one.fitted, noise) < lowest + ALIKE]
    chosen = min(alike, key=lambda one: len(one.fitted.camera.parameter_names))
    familiar = [one for one in choices if one.fitted.camera.name == own]
    familiar += [
        one for one in choices if one not in familiar and _extends(one.fitted.camera, CAMERA_MODELS[own], fits)
    ]
    for one in familiar:
        if not any(_beats(other, one, fits, noise, len(choices)) for other in choices):
            chosen = one
            break
    between = [
        Between(one, bic(one.fitted, noise) - bic(chosen.fitted, noise), _held(one, chosen, fits, noise, len(choices)))
        for one in choices
        if one is not chosen
    ]
    return chosen, between


def _beats(better: CameraChoice, one: CameraChoice, fits: Fits, noise: Noise, cameras: int) -> bool:
    """Whether another camera's candidate shows that one does not suffice."""
    if better is one:
        return False
    test = _held(one, better, fits, noise, cameras)
    if test is not None:
        return test.rejects
    best = min(_uncharged(held, better.fitted, noise) for held in fits.list_fitted(one.fitted.camera) if held.usable)
    return best - bic(better.fitted, noise) > DECISIVE


def _uncharged(one: FittedSubset, other: FittedSubset, noise: Noise) -> float:
    """BIC of a candidate that is not charged for parameters that it has more than another."""
    more = max(0, one.n_free - other.n_free)
    return bic(one, noise) - more * math.log(one.dof + one.n_free)


def _extends(camera: CameraModel, own: CameraModel, fits: Fits) -> bool:
    """Whether a camera holds another: the same chi-square with all of that one's terms."""
    of_camera = {term.name: term for term in find_terms(camera)}
    names = [term.name for term in find_terms(own)]
    if not set(names) <= set(of_camera):
        return False
    full, same = fits.fit(largest(own)), fits.fit(Subset(camera, tuple(of_camera[name] for name in names)))
    return same.n_free == full.n_free and abs(same.chi2 - full.chi2) <= ALIKE


def _held(one: CameraChoice, other: CameraChoice, fits: Fits, noise: Noise, cameras: int) -> NestedTest | None:
    """Test one camera's candidate against another's that holds it; None where that does not.

    As many tests count as in either camera: what is not needed in its own must not be needed because another has fewer terms.
    """
    smaller, larger = one.fitted, other.fitted
    if not set(smaller.subset.term_names) < set(larger.subset.term_names):
        return None
    of_other = {term.name: term for term in find_terms(larger.camera)}
    same = fits.fit(Subset(larger.camera, tuple(of_other[name] for name in smaller.subset.term_names)))
    if same.n_free != smaller.n_free or abs(same.chi2 - smaller.chi2) > ALIKE * noise.variance:
        return None
    more = len(larger.subset.terms) - len(smaller.subset.terms)
    looked_at = [count_tests(of, terms=more) * cameras for of in (smaller.subset, same.subset)]
    return nested_test(smaller, larger, noise, max(cameras, *looked_at))
