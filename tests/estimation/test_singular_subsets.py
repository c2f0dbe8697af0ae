"""Any two of the three singular values hold what all three do: the squares add up to the number of stars."""

from itertools import pairwise

import numpy as np
import pytest

from boresight.estimation import arcs, singular_values
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.singular_values import Selection
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.pinhole_fields import PINHOLE, WU_TRUTH, wu_field

SCALE = np.array([1e-3, 5e-4, 10.0, 10.0, 0.5, 1.0])
TWO_OR_MORE = [(2, 3), (1, 2), (1, 3), (1, 2, 3)]
SETS = 40


@pytest.fixture(scope="module")
def ends():
    fields = [wu_field(np.random.default_rng(seed), frames=60) for seed in range(SETS)]
    fields = [arcs.whiten(field, arcs.angular_sigma(PINHOLE, WU_TRUTH, field))[0] for field in fields]
    return {
        values: [
            FILTERS["svd"](field, start(WU_TRUTH, 6, 1.0), np.arange(6), SCALE, Tuning(selection=Selection(4, values)))
            for field in fields
        ]
        for values in TWO_OR_MORE
    }


@pytest.mark.parametrize(("values", "more"), [((1, 2), 0.02), ((1, 3), 0.005), ((1, 2, 3), 0.001)], ids=str)
def test_the_sigmas_are_those_of_the_second_and_third(ends, values, more):
    found, usual = (np.mean([history.sigmas[-1] for history in ends[each]], axis=0) for each in (values, (2, 3)))
    assert (found / usual < 1 + more).all()
    assert (found / usual > 1 - 0.001).all()


@pytest.mark.parametrize("values", TWO_OR_MORE, ids=str)
def test_every_subset_is_consistent(ends, values):
    errors = [nees((history.last.x - WU_TRUTH) / SCALE, history.last.P) for history in ends[values]]
    bounds = chi_square(sum(errors), 6 * SETS)
    assert bounds.consistent, (6 * bounds.mean, 6 * bounds.lower, 6 * bounds.upper)
    innovations = chi_square(*(sum(float(getattr(h, name).sum()) for h in ends[values]) for name in ("nis", "dof")))
    assert innovations.consistent


@pytest.mark.parametrize("values", TWO_OR_MORE, ids=str)
def test_the_scale_of_a_row_decides_nothing(values):
    field = wu_field(np.random.default_rng(1), frames=3)
    for first, last in pairwise(field.star_start):
        R = singular_values.exposure(field.s_i[first:last], np.full(last - first, 4e-5), Selection(4, values)).R
        scale = 2.0 ** np.random.default_rng(2).integers(-10, 10, len(R))
        kept = singular_values.determined_rows(R)
        assert singular_values.determined_rows(R * np.outer(scale, scale)).tolist() == kept.tolist()
