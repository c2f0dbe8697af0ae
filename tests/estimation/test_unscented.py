"""The unscented filter equals the textbook's in one pass, agrees with its peers near the truth, and is consistent when iterated."""

import numpy as np
import pytest

from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.metrics import arc_errors
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field, weighed

SINGLE = Tuning(linearisations=1)


def _whitened(frame, x):
    e, a0 = arc_errors(frame, x), 0
    for n in 2 * np.diff(frame.star_start) - 3:
        L = np.zeros((n, n))
        for d in range(5):
            L[np.arange(d, n), np.arange(n - d)] = frame.band[a0 + d : a0 + n, 4 - d]
        e[a0 : a0 + n] = np.linalg.solve(L, e[a0 : a0 + n])
        a0 += n
    return e


def _textbook(arcs, z, P, free, noise, forgetting=1.0):
    n, total = len(free), 0.0
    for k in range(arcs.n_frames):
        frame = arcs.frames(k, k + 1)
        P = P / forgetting + noise**2 * np.eye(n)
        spread = np.sqrt(n) * np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1]
        points = np.concatenate([z + spread.T, z - spread.T])
        states = np.tile(GROUND, (2 * n, 1))
        states[:, free] += points * SCALE[free]
        seen = np.array([_whitened(frame, x) for x in states])
        e, d = seen.mean(axis=0), points - z
        P_ee = (seen - e).T @ (seen - e) / (2 * n) + np.eye(len(e))
        K = np.linalg.solve(P_ee, (seen - e).T @ d / (2 * n)).T
        z, P = z - K @ e, P - K @ P_ee @ K.T
        total += e @ np.linalg.solve(P_ee, e)
    return z, P, total


@pytest.mark.parametrize("free", [FREE, np.array([0, 1, 4])], ids=["all", "three"])
@pytest.mark.parametrize(("noise", "forgetting"), [(0.0, 1.0), (0.05, 1.0), (0.02, 0.9)])
def test_one_pass_is_the_textbook_filter(free, noise, forgetting):
    arcs = weighed(star_field(np.random.default_rng(1), frames=6), TRUTH)
    tuning = Tuning(linearisations=1, process_noise=noise, forgetting=forgetting)
    history = FILTERS["ukf"](arcs, start(GROUND, len(free), 5.0), free, SCALE[free], tuning)
    z, P, total = _textbook(arcs, np.zeros(len(free)), 25.0 * np.eye(len(free)), free, noise, forgetting)
    np.testing.assert_allclose(history.last.z, z, atol=1e-6)
    np.testing.assert_allclose(history.last.P, P, atol=1e-7 * np.abs(P).max())
    assert history.nis.sum() == pytest.approx(total, rel=1e-6)
    np.testing.assert_array_equal(history.linearisations, 1)


def test_from_near_the_truth_it_agrees_with_the_square_root_filter():
    for seed in range(5):
        arcs = weighed(star_field(np.random.default_rng(20 + seed), frames=60), TRUTH)
        unscented, extended = (FILTERS[m](arcs, start(TRUTH, 8, 1.0), FREE, SCALE, Tuning()) for m in ("ukf", "sqrf"))
        assert np.abs((unscented.last.x - extended.last.x) / SCALE / extended.sigmas[-1]).max() < 0.1
        np.testing.assert_allclose(unscented.sigmas[-1], extended.sigmas[-1], rtol=0.03)


def test_iterated_it_is_consistent_from_a_far_start_and_in_one_pass_it_is_not():
    sets, iterated, single = 30, 0.0, []
    for seed in range(sets):
        arcs = weighed(star_field(np.random.default_rng(300 + seed), frames=60), TRUTH)
        arcs = pool_start(arcs, START_ARCS_PER_PARAMETER * 8)
        for tuning in (Tuning(), SINGLE):
            last = FILTERS["ukf"](arcs, start(GROUND, 8, 10.0), FREE, SCALE, tuning).last
            error = nees((last.x - TRUTH) / SCALE, last.P)
            if tuning is SINGLE:
                single.append(error)
            else:
                iterated += error
    assert chi_square(iterated, 8 * sets).consistent
    assert np.median(single) > 100


def test_points_in_a_settled_frame_are_drawn_once():
    arcs = weighed(star_field(np.random.default_rng(5), frames=80), TRUTH)
    passes = FILTERS["ukf"](arcs, start(TRUTH, 8, 1.0), FREE, SCALE, Tuning()).linearisations
    assert passes[0] > 1
    assert np.mean(passes[40:]) < 2.5


def test_frames_in_parts_give_the_history_of_the_whole():
    arcs = weighed(star_field(np.random.default_rng(6), frames=12), TRUTH)
    run, begin, tuning = FILTERS["ukf"], start(TRUTH, 8, 10.0), Tuning(process_noise=0.02, forgetting=0.95)
    whole = run(arcs, begin, FREE, SCALE, tuning)
    first = run(arcs.frames(0, 5), begin, FREE, SCALE, tuning)
    second = run(arcs.frames(5, 12), first.last, FREE, SCALE, tuning)
    np.testing.assert_allclose(np.concatenate([first.states, second.states]), whole.states, rtol=1e-12)
    np.testing.assert_allclose(second.last.S, whole.last.S, rtol=1e-9, atol=1e-14)
