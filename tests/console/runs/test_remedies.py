"""What is offered to try follows from the numbers of a result, and the form that it opens says the same."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.advice import STRAIGHT
from boresight.calibration.calibration import Cause, Trust, parse_calibration
from boresight.estimation.statistics.observability import WEAK
from boresight.verdicts.remedies import list_remedies


@pytest.fixture
def result(results):
    return parse_calibration(results["batch"])


def with_cause(result, name):
    return replace(result, causes=[Cause(name=name, likelihood=1.0, sentence="x", remedy="y", tests=[])])


def test_nothing_is_offered_for_a_result_without_doubts(result):
    assert list_remedies(replace(result, causes=[], trust=None)) == []
    assert list_remedies(None) == []


@pytest.mark.parametrize(
    ("cause", "settings"),
    [
        ("tails", {"robust": "stars"}),
        ("drift", {"method": "sqrf", "variant": "q"}),
        ("phase", {"noise_model": "from-data"}),
    ],
)
def test_a_cause_is_answered_by_settings_that_the_run_did_not_have(result, cause, settings):
    (remedy,) = list_remedies(replace(with_cause(result, cause), trust=None))
    assert remedy.settings == settings
    again = replace(result.inputs, settings=replace(result.inputs.settings, **settings))
    assert list_remedies(replace(with_cause(result, cause), trust=None, inputs=again)) == []


def test_a_lens_beyond_the_model_leads_to_the_choice_of_one(result):
    (remedy,) = list_remedies(replace(with_cause(result, "tangential"), trust=None))
    assert remedy.part == "distortion"


def test_suspects_are_left_out_beside_those_that_were_already(result):
    doubted = replace(result.trust or Trust(), suspects=[99, 42])
    before = replace(result.inputs, settings=replace(result.inputs.settings, leave_out_stars=(7,)))
    (remedy,) = list_remedies(replace(result, causes=[], trust=doubted, inputs=before))
    assert remedy.settings == {"leave_out_stars": "7,42,99"}


@pytest.mark.parametrize(("codes", "enough"), [([], WEAK), (["curved"], STRAIGHT)])
def test_what_is_held_leaves_every_direction_of_the_others_known(result, codes, enough):
    n = len(result.free)
    V = np.linalg.qr(np.random.default_rng(3).normal(size=(n, n)))[0]
    s = np.array([50.0] * (n - 2) + [0.5, 0.2])
    seen = replace(result.observability, singular_values=s.tolist(), right_singular_vectors=V.tolist())
    (remedy,) = list_remedies(replace(result, causes=[], trust=None, observability=seen, advice_codes=codes))
    left = [result.free.index(name) for name in remedy.free]
    A = ((V.T * s**2) @ V)[np.ix_(left, left)]
    assert 1 / np.sqrt(np.linalg.eigvalsh(A)[0]) <= enough
    assert 0 < len(remedy.free) < n


def test_of_a_weak_direction_one_way_to_hold_parameters_is_offered(result):
    n = len(result.free)
    seen = replace(
        result.observability, singular_values=[50.0] * (n - 1) + [0.2], right_singular_vectors=np.eye(n).tolist()
    )
    entries = [replace(one, needed=one.name != "a2_rad", settled=True) for one in result.trust.drop_one]
    spare = replace(result, causes=[], trust=replace(result.trust, drop_one=entries, stars=[]), observability=seen)
    (remedy,) = list_remedies(spare)
    assert remedy.free == tuple(result.free[:-1])


def test_what_the_data_do_not_ask_for_may_be_held(result):
    entries = [replace(one, needed=one.name != "a2_rad", settled=True) for one in result.trust.drop_one]
    spare = replace(result, causes=[], trust=replace(result.trust, drop_one=entries, stars=[]))
    (remedy,) = list_remedies(spare)
    assert remedy.free == tuple(name for name in result.free if name != "a2_rad")
