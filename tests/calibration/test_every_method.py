"""Every camera by every way to calibrate that the options offer: it ends at the truth as its sigmas say, and is read back."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2

from boresight.calibration.calibration import parse_calibration
from boresight.calibration.options import ALL, METHODS, OPTIONS, CalibrationSettings
from boresight.cameras import CAMERA_MODELS, DEFAULT_CAMERA
from boresight.errors import RefusedInputError
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.observability import is_curved
from tests.calibration.sets import described, lens_case
from tests.effort import effort

#: Ways whose compiled loops other tests need too; those of the others are for the full run.
COMPILED = {("kannala_brandt", "sqrf"), ("brown_conrady", "ukf")}


def list_ways():
    """List every method, as it is and with each other word of a choice that only some methods have."""
    for method in METHODS:
        yield {"method": method}
        for name, one in OPTIONS.items():
            if method in one.methods != ALL and one.kind in {"word", "whole", "yes or no"}:
                words = [True] if one.kind == "yes or no" else one.words
                for word in words:
                    way = {"method": method, name: int(word) if one.kind == "whole" else word}
                    if way[name] != one.default and is_accepted(way):
                        yield way


def is_accepted(way):
    try:
        CalibrationSettings(**way).check()
    except RefusedInputError:
        return False
    return True


def by_every_way():
    for model, way in product(CAMERA_MODELS, list_ways()):
        here = model == DEFAULT_CAMERA.name or way["method"] == "batch" or (model, way["method"]) in COMPILED
        yield pytest.param(
            model, way, id=f"{model}-{'-'.join(map(str, way.values()))}", marks=[] if here else pytest.mark.full
        )


def test_every_method_and_every_choice_of_some_methods_alone_is_among_the_ways():
    ways = list(list_ways())
    assert {way["method"] for way in ways} == set(METHODS)
    assert {"method": "batch", "robust": "huber"} in ways
    assert {"method": "ukf", "variant": "q"} in ways
    assert {"method": "svd", "star_model": 2} in ways


def quadratic_form_limit(PA):
    """What d^T A d of d with covariance P exceeds once in a hundred thousand, by the chi-square of the same mean and variance."""
    mean, variance = np.trace(PA), 2 * np.trace(PA @ PA)
    return variance / (2 * mean) * chi2.ppf(1 - 1e-5, 2 * mean**2 / variance)


@pytest.mark.few(8)
@pytest.mark.parametrize(("model", "way"), list(by_every_way()))
def test_every_camera_by_every_way_ends_at_the_truth_as_its_sigmas_say_and_is_read_back(model, way, catalogue):
    sets, total = effort(1, 20), 0.0
    for seed in range(sets):
        found, truth = lens_case(catalogue, model, seed, **way)
        result = described(found)
        assert result.status == "converged"
        low, high = chi2.ppf([1e-5, 1 - 1e-5], result.chi2.dof)
        best, (A, P) = found.ground, (found.estimate.A, found.estimate.P)
        assert low < best.e @ best.e < high
        assert result.chi2.value - best.e @ best.e < quadratic_form_limit(P @ A)
        for name, true in zip(CAMERA_MODELS[model].parameter_names, truth, strict=True):
            assert abs(result.parameters[name] - true) < 5 * result.sigma[name]
        total += nees((found.estimate.x - truth) / found.parameters.scale, found.estimate.P)
        assert (result.observability.chi2_rise is None) == (way["method"] != "batch")
        assert not is_curved(result.observability.chi2_rise)
        assert "curved" not in result.advice_codes
        written = result.to_json()
        assert parse_calibration(written).to_json() == written
    assert total < chi2.ppf(0.999, sets * len(truth))


@pytest.mark.parametrize(("model", "focal_px"), [("brown_conrady", 4000.0)])
def test_points_beyond_the_turn_of_a_lens_are_drawn_nearer_and_the_filter_ends_where_the_batch_does(
    model, focal_px, catalogue
):
    sets, totals = effort(3, 30), {"ukf": 0.0, "batch": 0.0}
    for seed in range(sets):
        found, (_, truth) = {}, (None, None)
        for method in totals:
            found[method], truth = lens_case(catalogue, model, seed, focal_px=focal_px, method=method)
            one = found[method]
            assert one.estimate.status == "converged"
            totals[method] += nees((one.estimate.x - truth) / one.parameters.scale, one.estimate.P)
        P = found["batch"].estimate.P
        apart = (found["ukf"].estimate.x - found["batch"].estimate.x) / one.parameters.scale
        assert nees(apart, P) < 0.1**2 * len(truth)
        shares = np.linalg.eigvals(np.linalg.solve(P, found["ukf"].estimate.P)).real
        assert shares == pytest.approx(1, abs=0.05)
    assert totals["ukf"] == pytest.approx(totals["batch"], rel=0.02)
    assert totals["ukf"] < chi2.ppf(0.999, sets * len(truth))
