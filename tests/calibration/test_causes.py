"""Tests of trust as one family, and the causes that explain them: false alarms, first advice, size, coverage."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from benchmarks.causes import CASES, judge, make_set, name_first
from boresight.calibration.calibration import Coverage
from boresight.calibration.trust import trust_advice
from boresight.calibration.trust.causes import CAUSES
from boresight.calibration.trust.fitted_set import FAMILY_LEVEL, UNLIKELY
from boresight.calibration.trust.trust_tests import KIND_OF_TEST, MATTERS, TRUST_TESTS, adjust
from boresight.verdicts.gates.measurements import GATES
from boresight.verdicts.verdict import make_verdict
from tests.calibration.sets import case, field, simulated, unverified

#: Causes that the small form looks at: of the lens, of time, of the pixel, of the sky, of single stars.
FEW = ("tangential", "step", "phase", "aberration", "identities")


def test_the_table_names_every_test_once_with_a_gate_and_words_and_its_size_is_that_of_the_level():
    assert len({kind.name for kind in TRUST_TESTS}) == len(TRUST_TESTS)
    assert pytest.approx(FAMILY_LEVEL / len(TRUST_TESTS)) == UNLIKELY
    for kind in TRUST_TESTS:
        assert kind.gate in GATES
        assert kind.finding != kind.sound
    for cause in CAUSES.values():
        assert set(cause.tests) <= {kind.name for kind in TRUST_TESTS}
    assert {name for cause in CAUSES.values() for name in cause.tests} == {kind.name for kind in TRUST_TESTS}


def test_holms_correction_is_that_of_its_definition():
    assert adjust([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert adjust([0.5, 0.9]) == [1.0, 1.0]
    assert adjust([]) == []
    p = np.random.default_rng(2).uniform(size=(20_000, len(TRUST_TESTS)))
    assert 0.003 < np.mean([min(adjust(row)) < FAMILY_LEVEL for row in p.tolist()]) < 0.007


@pytest.mark.parametrize("name", FEW)
def test_the_first_advice_names_what_spoiled_the_set_and_verdict_and_gate_hear_of_it(name, catalogue):
    with unverified():
        found = judge(make_set(CASES[name], 1, 100, catalogue))
    assert found.causes[0].name in CASES[name].right
    assert found.causes[0].sentence in found.advice[0]
    assert found.causes[0].remedy in found.advice[0]
    assert 0.5 < found.causes[0].likelihood <= 1
    noticed = [test for test in found.tests if test.noticed]
    assert noticed
    assert set(found.causes[0].tests) <= {test.name for test in noticed}
    verdict = make_verdict(found)
    assert verdict.level != "normal"


def test_a_clean_set_is_not_called_into_question(catalogue):
    for seed in range(3):
        with unverified():  # which says by itself what it removes, in one clean set of a hundred
            found = judge(make_set(None, seed, 100, catalogue))
        assert found.causes == []
        assert not any(test.noticed for test in found.tests)
        # these images are declared to be from space
        assert [test.name for test in found.tests] == [kind.name for kind in TRUST_TESTS if kind.name != "refraction"]
        assert found.advice == []


@pytest.mark.full
def test_the_first_advice_is_right_in_nine_of_ten_sets(catalogue):
    right = [
        name_first(judge(make_set(one, 5000 + seed, 150, catalogue))) in one.right
        for one in CASES.values()
        for seed in range(6)
    ]
    assert np.mean(right) >= 0.9


@pytest.mark.full
def test_at_most_one_of_a_hundred_clean_sets_is_called_into_question(catalogue):
    found = [judge(make_set(None, 10_000 + seed, (60, 150, 300)[seed % 3], catalogue)) for seed in range(300)]
    alarms = sum(any(test.noticed for test in one.tests) for one in found)
    assert stats.binomtest(alarms, len(found), 0.01, alternative="greater").pvalue > 0.01
    for name in (
        "tangential",
        "radial",
        "affine",
        "lens",
        "phase",
        "time",
        "temperature",
        "drift",
        "magnitude",
        "colour",
    ):
        p = [test.probability for one in found for test in one.tests if test.name == name]
        assert stats.kstest(p, "uniform").pvalue > 1e-4


def test_a_wrong_sigma_trips_the_test_of_noise_and_no_other_displacement(sensor, catalogue):
    told = case(field(3, frames=120), replace(sensor, centroid_sigma_px=0.2), catalogue).report
    assert [cause.name for cause in told.causes] == ["noise"]
    noticed = {test.name for test in told.tests if test.noticed}
    assert "chi_square" in noticed
    assert not noticed & {"tangential", "radial", "affine", "lens", "phase", "time", "drift", "aberration"}
    assert " 2.2 times " in told.causes[0].sentence


def test_what_moves_stars_by_next_to_nothing_is_noticed_in_a_very_large_set_and_fails_nothing():
    def effect(fall, n_arcs, misled=50.0):
        sums = SimpleNamespace(A=np.eye(8), n_arcs=n_arcs)
        score = SimpleNamespace(dof=2, p=1e-30, fall=fall, misled=misled)
        return dict(outcome(SimpleNamespace(scores={"tangential": score, "phase": score}, sums=sums, trials={})))

    def outcome(examined):
        return [(name, KIND_OF_TEST[name].ask(examined)[1]) for name in ("tangential", "phase")]

    assert effect(402.0, 10_000) == {"tangential": 50.0, "phase": 50.0}  # a fifth of the noise
    # what stays moves directions farther than the parameter that it moves most
    assert effect(402.0, 10_000, 2.0) == {"tangential": pytest.approx(np.sqrt(400 / 8)), "phase": 2.0}
    assert effect(402.0, 1_000_000) == {"tangential": MATTERS, "phase": MATTERS}  # a fiftieth
    assert effect(10.0, 1_000_000, 0.5)["tangential"] == pytest.approx(1.0)


def test_stars_in_one_quarter_of_the_detector_are_said_with_the_error_elsewhere_though_no_direction_is_weak(catalogue):
    trust = simulated(catalogue, seed=3).report.trust
    counts = np.zeros((12, 16), int)
    counts[:6, :8] = 9
    edges = {
        "row_edges_px": np.linspace(-0.5, 1943.5, 13).tolist(),
        "col_edges_px": np.linspace(-0.5, 2591.5, 17).tolist(),
    }
    (sentence,) = trust_advice(trust, Coverage(**edges, counts=counts.tolist()))[:1]
    assert sentence.code == "coverage"
    assert " 12 of 48 " in sentence
    assert re.search(r"off by [\d.]+ arcsec", sentence)
    assert trust_advice(trust, Coverage(**edges, counts=(counts + 1).tolist())) == trust_advice(trust)
