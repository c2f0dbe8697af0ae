"""The geometric check of the flight code as a compiled loop: which matches of an exposure agree with each other.

A match says that detection i is star i. Two matches agree when the arc between the detections, as the camera measures it, and the
arc between the stars of the catalogue differ by no more than the tolerance (E section III-A.2). The match with the most
disagreements is dropped, again and again, until none is left: at most n^3 steps for n matches, where the largest set that agrees,
a maximum clique, would cost an exponential search. Of two matches with equally many disagreements the one whose arcs exceed the
tolerance by more in sum is dropped, and of equal ones the later row.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.arclengths import angle
from boresight.kernels.compilation import loop, part

_part, _inlined = part(), part(forceinline=True)


@_inlined
def _sine_and_cosine(g, at, i, j):
    """Return sine and cosine of the angle between directions i and j, columns of three rows of `g` from `at` on."""
    x = g[at + 1, i] * g[at + 2, j] - g[at + 2, i] * g[at + 1, j]
    y = g[at + 2, i] * g[at, j] - g[at, i] * g[at + 2, j]
    z = g[at, i] * g[at + 1, j] - g[at + 1, i] * g[at, j]
    cosine = g[at, i] * g[at, j] + g[at + 1, i] * g[at + 1, j] + g[at + 2, i] * g[at + 2, j]
    return math.sqrt(x * x + y * y + z * z), cosine


@_part
def _agree(g, n, tolerance):
    """Return whether all arcs between n matches agree, from the sine of each difference: without an arctangent.

    The first three rows of `g` are measured directions, the others the catalogue's. All arcs of a match are looked at before
    one ends the search, so that they are taken several at a time.
    """
    sine, cosine = math.sin(tolerance), math.cos(tolerance) - 1e-12
    for i in range(1, n):
        disagree = 0
        for j in range(i):
            sine_d, cosine_d = _sine_and_cosine(g, 0, i, j)
            sine_i, cosine_i = _sine_and_cosine(g, 3, i, j)
            off = abs(sine_d * cosine_i - cosine_d * sine_i)
            disagree += 0 if (off <= sine) & (cosine_d * cosine_i + sine_d * sine_i >= cosine) else 1
        if disagree > 0:
            return False
    return True


@_part
def _compare(g, n, tolerance, excess, count):
    """Fill by how much each two matches' arc is beyond the tolerance, 0 where they agree, and with how many each disagrees."""
    for i in range(n):
        count[i], excess[i, i] = 0, 0.0
        for j in range(i):
            sine_d, cosine_d = _sine_and_cosine(g, 0, i, j)
            sine_i, cosine_i = _sine_and_cosine(g, 3, i, j)
            beyond = abs(angle(sine_d, cosine_d) - angle(sine_i, cosine_i)) - tolerance
            over = beyond > 0.0  # of what has no direction nothing is
            excess[i, j] = beyond if over else 0.0
    for i in range(n):
        for j in range(i):
            excess[j, i] = excess[i, j]
            count[i] += excess[i, j] > 0.0
            count[j] += excess[i, j] > 0.0


@_part
def _worst(excess, count, kept, n):
    """Return the place of the match to drop from the first n, or -1 when all that are kept agree."""
    most, place, largest = 0, -1, -1.0
    for i in range(n):
        if kept[i]:
            most = max(most, count[i])
    for i in range(n):
        if most > 0 and kept[i] and count[i] == most:
            total = 0.0
            for j in range(n):
                total += excess[i, j]
            if total >= largest:
                place, largest = i, total
    return place


@_part
def _drop(excess, count, place, n):
    """Let nobody disagree with a match any more."""
    for i in range(n):
        count[i] -= excess[i, place] > 0.0
        excess[i, place] = 0.0


@loop("i1 f2 f2 b1 f b1")
def agreeing_matches(exposure_start, s_d, s_i, matched, tolerance, accepted):
    """Mark the matches of each exposure that agree among themselves.

    The caller is `calibration.matching.flight_check.check_flight`. `s_d`, `s_i` (n_rows, 3) are measured and catalogue directions,
    `matched` (n_rows,) says which rows have both, `tolerance` is in rad; fills `accepted` (n_rows,).
    """
    most, small = 0, tolerance < 1.0  # so that sine and cosine tell a difference from its reverse
    for k in range(len(exposure_start) - 1):
        most = max(most, exposure_start[k + 1] - exposure_start[k])
    rows, kept, excess = np.empty(most, np.int64), np.empty(most, np.bool_), np.empty((most, most))
    g, count = np.empty((6, most)), np.empty(most, np.int64)
    for k in range(len(exposure_start) - 1):
        n = 0
        for row in range(exposure_start[k], exposure_start[k + 1]):
            accepted[row] = False
            if matched[row]:
                rows[n], kept[n] = row, True
                for axis in range(3):
                    g[axis, n], g[3 + axis, n] = s_d[row, axis], s_i[row, axis]
                n += 1
        if small and _agree(g, n, tolerance):
            for i in range(n):
                accepted[rows[i]] = True
            continue
        _compare(g, n, tolerance, excess, count)
        place = _worst(excess, count, kept, n)
        while place >= 0:
            kept[place] = False
            _drop(excess, count, place, n)
            place = _worst(excess, count, kept, n)
        for i in range(n):
            accepted[rows[i]] = kept[i]
