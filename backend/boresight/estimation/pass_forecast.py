"""What the passes so far forecast of the next: a random walk about temperature and time, one pass after the other.

Pass k has the estimate theta_k with covariance P_k, at the time t_k and the temperature T_k. With columns v_k of what is known of
it (`calibration.joint.evidence`: temperature, time, temperature squared, each from its mean and to its half range)

    theta_k = p_k + c v_k + e_k        p_k = p_{k-1} + w_k        e_k ~ N(0, P_k)        w_k ~ N(0, diag(q^2) days_k)

so s = (p, c) is followed by a Kalman filter, and with H_k = [I, v_k] and C the covariance of s before pass k

    d_k = theta_k - H_k s        S_k = H_k C H_k^T + P_k        D_k^2 = d_k^T S_k^-1 d_k

is chi-square with n degrees of freedom, and what pass k errs is in no other d: at the level alpha the expected number of passes
outside of their forecast is alpha times their number, and the number itself is binomial. Against one pass that stays the reference
D^2 has the same distribution, but all of them share that pass's error: the same number of false alarms on average, in bursts.

The drift q is the likeliest under caution (`estimation.walk`), from the passes that were there before, estimated again each time a
quarter more have come. Too few passes leave the drift open, and then there is no forecast.

A pass outside of its forecast is a step, or wrong. Which of the two the next pass tells: both are carried until then, and it is
held against the one that it is nearer to. Where that is the forecast without the pass, the pass is left out; else all parameters
stepped there. So one false alarm brings no second: nothing is ever forecast from an outlier alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import BoolArray, FloatArray
from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Regressed
from boresight.estimation.statistics.drift import ChiSquareTest, Epoch, baseline_test
from boresight.estimation.walk import CAUTION, FEWEST_STEPS, STARTS, WalkedPasses, most_likely

#: Fewest passes that forecast one, and by how much their number grows until the drift is estimated again.
FEWEST, GROWTH = FEWEST_STEPS + 3, 1.25
#: Sigmas of a pass of what nobody knows.
OPEN = 1e3
#: Share of a column that the others leave over, below which it is not told from them.
TOLD_APART = 1e-3


@dataclass(frozen=True)
class _Columns:
    """Which columns there are, with the means and half ranges (n_columns,) that they are taken from and to."""

    with_temperature: bool
    powers: tuple[int, ...]  # 0 is time
    middle: FloatArray
    half: FloatArray

    def make_row(self, epoch: Epoch) -> FloatArray:
        """The columns of one pass, (n_columns,)."""
        T0, t0 = self.middle
        raw = [epoch.t_d - t0 if power == 0 else (epoch.temperature_c - T0) ** power for power in self.powers]
        return np.array(raw) / self.half


@dataclass(frozen=True)
class _State:
    """s (n + n n_columns,) and its covariance after the pass at the time t_d."""

    t_d: float
    s: FloatArray
    C: FloatArray


@dataclass(frozen=True)
class _Model:
    """Drift (n,) a root of a day, columns, origin and scale (n,) of the parameters, SI."""

    q: FloatArray
    columns: _Columns
    origin: FloatArray
    scale: FloatArray

    def predict(self, state: _State, t_d: float) -> _State:
        """Let the parameters walk until a time."""
        C = state.C.copy()
        walked = self.q**2 * max(t_d - state.t_d, 0.0)
        C[np.arange(len(walked)), np.arange(len(walked))] += walked
        return replace(state, t_d=t_d, C=C)

    def open_(self) -> _State:
        """What is known before any pass."""
        n = len(self.q) * (1 + len(self.columns.powers))
        return _State(0.0, np.zeros(n), OPEN**2 * np.eye(n))

    def stepped(self, state: _State) -> _State:
        """Let every parameter step by what nobody knows."""
        n, C = len(self.q), state.C.copy()
        C[np.arange(n), np.arange(n)] += OPEN**2
        return replace(state, C=C)

    def value(self, state: _State, at: Epoch) -> Epoch:
        """The parameters at a pass's time and temperature, SI."""
        H = self._design(at)
        return replace(
            at,
            value=self.origin + self.scale * (H @ state.s),
            covariance=H @ state.C @ H.T * np.outer(self.scale, self.scale),
        )

    def update(self, state: _State, epoch: Epoch) -> _State:
        """Add what a pass knows, in Joseph's form."""
        H, P = self._design(epoch), epoch.covariance / np.outer(self.scale, self.scale)
        K = np.linalg.solve(H @ state.C @ H.T + P, H @ state.C).T
        left = np.eye(len(state.s)) - K @ H
        C = left @ state.C @ left.T + K @ P @ K.T
        return replace(state, s=state.s + K @ ((epoch.value - self.origin) / self.scale - H @ state.s), C=(C + C.T) / 2)

    def _design(self, epoch: Epoch) -> FloatArray:
        return np.kron(np.concatenate([[1.0], self.columns.make_row(epoch)]), np.eye(len(self.q)))


@dataclass(frozen=True)
class FollowedPass:
    """A pass held against what those before it forecast.

    Parameters
    ----------
    own
        The pass itself.
    forecast, test
        What those before it forecast of its time and temperature, and the pass against it; None where there are too few.
    """

    own: Epoch
    forecast: Epoch | None = None
    test: ChiSquareTest | None = None
    _model: _Model | None = None
    _state: _State | None = None

    @property
    def is_outside(self) -> bool:
        """Whether it is outside of its forecast."""
        return self.test is not None and self.test.rejects

    def state_at(self, temperature_c: float) -> Epoch:
        """The parameters at the pass's time and a temperature, with the pass among what is known; NaN is the mean of the passes.

        Where there is no forecast it is the pass itself.
        """
        if self._model is None or self._state is None:
            return self.own
        T = temperature_c if np.isfinite(temperature_c) else float(self._model.columns.middle[0])
        return self._model.value(self._state, replace(self.own, temperature_c=T))


class PassForecaster:
    """Follows the passes of a sensor, all of the same parameters, in the order of their time."""

    def __init__(self, alpha: float) -> None:
        self.alpha = alpha
        self._kept: list[Epoch] = []
        self._stepped: list[bool] = []
        self._model: _Model | None = None
        self._state = _State(0.0, np.zeros(0), np.zeros((0, 0)))
        self._in_doubt: tuple[Epoch, _State] | None = None
        self._next_estimate = FEWEST

    def follow(self, epoch: Epoch) -> FollowedPass:
        """Hold a pass against its forecast, and take it in; raises LinAlgError where its covariance is none."""
        np.linalg.cholesky(epoch.covariance / np.outer(*[np.sqrt(np.diag(epoch.covariance))] * 2))
        if self._model is None or self._lacks_temperature(epoch):
            self._keep(epoch, stepped=False)
            return FollowedPass(epoch)
        before = self._resolve(self._model, epoch)
        forecast = self._model.value(before, epoch)
        test = baseline_test(epoch, forecast, self.alpha)
        if test is None:
            return FollowedPass(epoch)
        if test.rejects:
            after = self._model.update(self._model.stepped(before), epoch)
            self._in_doubt = (epoch, after)
            return FollowedPass(epoch, forecast, test, self._model, after)
        self._state = self._model.update(before, epoch)
        followed = FollowedPass(epoch, forecast, test, self._model, self._state)
        self._keep(epoch, stepped=False)
        return followed

    def _lacks_temperature(self, epoch: Epoch) -> bool:
        return self._model is not None and self._model.columns.with_temperature and np.isnan(epoch.temperature_c)

    def _resolve(self, model: _Model, epoch: Epoch) -> _State:
        """What is known at a pass; the pass before it that was in doubt is left out or is a step, whichever is nearer to this."""
        before = model.predict(self._state, epoch.t_d)
        if self._in_doubt is None:
            return before
        doubted, after = self._in_doubt
        self._in_doubt = None
        stepped = model.predict(after, epoch.t_d)
        tests = [baseline_test(epoch, model.value(one, epoch), self.alpha) for one in (before, stepped)]
        if tests[0] is None or tests[1] is None or tests[0].statistic <= tests[1].statistic:
            return before
        self._state = after
        self._kept.append(doubted)
        self._stepped.append(True)
        return stepped

    def _keep(self, epoch: Epoch, *, stepped: bool) -> None:
        self._kept.append(epoch)
        self._stepped.append(stepped)
        if len(self._kept) >= self._next_estimate:
            self._next_estimate = int(np.ceil(GROWTH * len(self._kept)))
            self._estimate()

    def _estimate(self) -> None:
        """Estimate the drift from all passes that were kept, and follow them again with it."""
        scale = np.median([np.sqrt(np.diag(one.covariance)) for one in self._kept], axis=0)
        origin, n = self._kept[0].value, len(scale)
        columns, values = _find_columns(self._kept)
        days = np.maximum(np.diff([one.t_d for one in self._kept]), 0.0)
        z = np.array([(one.value - origin) / scale for one in self._kept])
        sums = [
            NormalEquations(
                np.asarray(np.linalg.inv(one.covariance / np.outer(scale, scale)), np.float64), np.zeros(n), 0.0, 0.0
            )
            for one in self._kept
        ]
        own = np.arange(n)
        trend = Regressed(np.repeat(own, values.shape[1]), np.tile(values, (1, n))) if values.shape[1] else None
        stepped: BoolArray = np.repeat(np.array(self._stepped[1:])[:, None], n, axis=1)
        passes = WalkedPasses(sums, z, own, days, trend, stepped)
        try:
            starts = [np.full(n, start) for start in STARTS] if self._model is None else [self._model.q]
            q = most_likely(passes, starts, CAUTION)
        except np.linalg.LinAlgError:
            return
        self._model = _Model(q, columns, origin, scale)
        state = self._model.open_()
        for one, jumped in zip(self._kept, self._stepped, strict=True):
            state = self._model.predict(state, one.t_d) if state.t_d else replace(state, t_d=one.t_d)
            state = self._model.update(self._model.stepped(state) if jumped else state, one)
        self._state = state


def _find_columns(kept: list[Epoch]) -> tuple[_Columns, FloatArray]:
    """Return the columns that the passes tell apart and that leave enough of them to the walk, with their values."""
    T, t = np.array([one.temperature_c for one in kept]), np.array([one.t_d for one in kept])
    warm = bool(np.isfinite(T).all())
    middle = np.array([T.mean() if warm else np.nan, t.mean()])
    raw = {0: t - middle[1]} | ({1: T - middle[0], 2: (T - middle[0]) ** 2} if warm else {})
    powers, half, found = [], [], [np.ones(len(kept))]
    for power in (1, 0, 2) if warm else (0,):
        most = float(np.abs(raw[power]).max())
        if not most or len(kept) - 1 - len(found) < FEWEST_STEPS:
            continue
        X, column = np.column_stack(found), raw[power] / most
        if np.abs(column - X @ np.linalg.lstsq(X, column, rcond=None)[0]).max() > TOLD_APART:
            powers.append(power)
            half.append(most)
            found.append(column)
    with_temperature = any(power > 0 for power in powers)
    return _Columns(with_temperature, tuple(powers), middle, np.array(half)), np.column_stack(found)[:, 1:]
