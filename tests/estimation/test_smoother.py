"""The smoother: the whole problem by dense least squares, the batch where nothing moves, and errors as wide as it says."""

import numpy as np
import pytest

from boresight.estimation import batch
from boresight.estimation.filters import FILTERS, FilterState, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.prior import Prior
from boresight.estimation.smoother import smooth
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.effort import effort
from tests.estimation.fields import (
    FREE,
    GROUND,
    SCALE,
    TRUTH,
    joined,
    star_field,
    whitened,
    whitened_plainly,
    whitened_rows,
)

NONE = np.zeros(8)
SOME = np.array([0.05, 0.0, 0.1, 0.0, 0.0, 0.02, 0.0, 0.0])


def steps_of(n, a_frame, gaps=None):
    return a_frame * np.sqrt(np.ones(n) if gaps is None else gaps)[:, None]


def walked(rng, q, mean_stars=10.7):
    """Frames of a camera whose parameters step by q before each but the first, and its states."""
    states = TRUTH + SCALE * np.cumsum(np.concatenate([NONE[None], q[1:] * rng.normal(size=q[1:].shape)]), axis=0)
    parts = [whitened(star_field(rng, frames=1, truth=x, mean_stars=mean_stars), x) for x in states]
    return joined(parts), states


def dense(arcs, begin, q, at):
    """Step of all states and their covariance by one least-squares problem of every row, from states `at`."""
    n, n_free = q.shape
    x = np.tile(begin.x, (n, 1))
    x[:, FREE] += SCALE * (at - begin.z)
    moves = [np.flatnonzero(steps) for steps in q]
    held = np.zeros((n, n_free), np.int64)  # column of every state in the unknowns: what does not move shares one
    held[0] = np.arange(n_free)
    unknowns = n_free
    for k in range(1, n):
        held[k] = held[k - 1]
        held[k, moves[k]] = unknowns + np.arange(len(moves[k]))
        unknowns += len(moves[k])
    rows, right = [], []
    for k in range(n):
        frame = arcs.frames(k, k + 1)
        _, H = whitened_rows(frame, x[k], FREE, SCALE)
        J = np.zeros((len(H), unknowns))
        np.add.at(J.T, held[k], H.T)
        rows.append(J)
        right.append(whitened_plainly(frame, x[k]))
        for i in moves[k] if k else ():
            J = np.zeros((1, unknowns))
            J[0, held[k, i]], J[0, held[k - 1, i]] = 1 / q[k, i], -1 / q[k, i]
            rows.append(J)
            right.append([(at[k, i] - at[k - 1, i]) / q[k, i]])
    root = np.linalg.inv(np.linalg.cholesky(begin.P + np.diag(q[0] ** 2)))
    J = np.zeros((n_free, unknowns))
    J[:, held[0]] = root
    rows.append(J)
    right.append(root @ (at[0] - begin.z))
    J, e = np.concatenate(rows), np.concatenate(right)
    P = np.linalg.inv(J.T @ J)
    step = -P @ (J.T @ e)
    return step[held], np.array([P[np.ix_(one, one)] for one in held])


@pytest.mark.parametrize("gaps", [None, [1, 1, 40, 1, 3600, 1, 0, 2]], ids=["even", "with gaps"])
def test_it_is_the_dense_problem_of_all_frames_within_1e_6_sigma(gaps):
    rng = np.random.default_rng(3)
    q = steps_of(8, SOME, gaps)
    arcs, _ = walked(rng, q)
    begin = start(GROUND, 8, 10.0)
    found = smooth(arcs, begin, FREE, SCALE, q, TRUTH)
    step, P = dense(arcs, begin, q, found.z)
    assert found.settled
    assert np.abs(step / found.sigma).max() < 1e-6
    for S, covariance in zip(found.S, P, strict=True):
        np.testing.assert_allclose(S @ S.T, covariance, rtol=1e-6, atol=1e-9 * np.abs(covariance).max())


def test_it_is_the_batch_where_nothing_moves_within_1e_6_sigma():
    arcs = whitened(star_field(np.random.default_rng(2), frames=60), TRUTH)
    begin = start(GROUND, 8, 10.0)
    found = smooth(arcs, begin, FREE, SCALE, steps_of(60, NONE), TRUTH)
    fitted = batch.fit(arcs, GROUND, FREE, SCALE, rest=1e-9, prior=Prior(GROUND, 100.0 * np.eye(8)))
    P = np.linalg.inv(fitted.A + np.eye(8) / 100.0)
    z = (fitted.x - GROUND) / SCALE
    np.testing.assert_allclose((found.z - z) / np.sqrt(np.diag(P)), 0, atol=1e-6)
    np.testing.assert_allclose(found.sigma, np.tile(np.sqrt(np.diag(P)), (60, 1)), rtol=1e-6)
    assert found.chi2 == pytest.approx(fitted.chi2, rel=1e-8)


def test_its_end_is_the_filters_end_and_it_is_never_less_sure():
    rng, q = np.random.default_rng(4), steps_of(40, SOME)
    arcs, _ = walked(rng, q)
    begin = FilterState(TRUTH.copy(), NONE, np.eye(8))
    found = smooth(arcs, begin, FREE, SCALE, q, TRUTH)
    filtered = FILTERS["sqrf"](arcs, begin, FREE, SCALE, Tuning(process_noise=SOME))
    np.testing.assert_allclose((found.z[-1] - filtered.last.z) / found.sigma[-1], 0, atol=0.1)
    assert (found.sigma < 1.02 * filtered.sigmas).all()
    assert found.sigma[5, 0] < 0.7 * filtered.sigmas[5, 0]


def test_errors_are_as_wide_as_it_says_at_the_start_in_the_middle_and_at_the_end():
    sets, places = effort(30, 200), [0, 7, 15, 19]
    totals = np.zeros(len(places))
    for seed in range(sets):
        rng = np.random.default_rng([70, seed])
        q = steps_of(20, SOME, rng.choice([1.0, 25.0], 20))
        arcs, states = walked(rng, q)
        begin = FilterState(TRUTH + SCALE * rng.normal(size=8), NONE, np.eye(8))
        found = smooth(arcs, begin, FREE, SCALE, q, TRUTH)
        errors = found.z - (states - begin.x) / SCALE
        totals += [nees(errors[k], found.S[k] @ found.S[k].T) for k in places]
    for total in totals:
        assert chi_square(total, 8 * sets).consistent


def test_a_set_in_a_file_gives_the_same_bits(monkeypatch):
    q = steps_of(30, SOME)
    arcs, _ = walked(np.random.default_rng(5), q)
    begin = start(GROUND, 8, 10.0)
    in_memory = smooth(arcs, begin, FREE, SCALE, q, TRUTH)
    monkeypatch.setattr("boresight.estimation.smoother.IN_MEMORY", 10)
    in_file = smooth(arcs, begin, FREE, SCALE, q, TRUTH)
    assert (in_memory.z == in_file.z).all()
    assert (in_memory.S == in_file.S).all()
