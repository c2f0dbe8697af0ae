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

from boresight.kernels.compilation import loop, part

_part = part()


@_part
def _arclength(s, i, j):
    """Return the angle between unit vectors i and j of `s` (n, 3) by atan2, rad."""
    sine, cosine = _sine_and_cosine(s, i, j)
    return math.atan2(sine, cosine)


@_part
def _sine_and_cosine(s, i, j):
    """Return sine and cosine of the angle between unit vectors i and j of `s` (n, 3)."""
    cx = s[i, 1] * s[j, 2] - s[i, 2] * s[j, 1]
    cy = s[i, 2] * s[j, 0] - s[i, 0] * s[j, 2]
    cz = s[i, 0] * s[j, 1] - s[i, 1] * s[j, 0]
    cosine = s[i, 0] * s[j, 0] + s[i, 1] * s[j, 1] + s[i, 2] * s[j, 2]
    return math.sqrt(cx * cx + cy * cy + cz * cz), cosine


@_part
def _agree(s_d, s_i, rows, n, tolerance):
    """Return whether all arcs between the first n matches agree, from the sine of each difference: without an arctangent."""
    sine, cosine = math.sin(tolerance), math.cos(tolerance)
    for i in range(n):
        for j in range(i):
            sine_d, cosine_d = _sine_and_cosine(s_d, rows[i], rows[j])
            sine_i, cosine_i = _sine_and_cosine(s_i, rows[i], rows[j])
            off = abs(sine_d * cosine_i - cosine_d * sine_i)
            if not (off <= sine and cosine_d * cosine_i + sine_d * sine_i >= cosine - 1e-12):
                return False
    return True


@_part
def _worst(excess, kept, n):
    """Return the place of the match to drop from the first n of `excess`, or -1 when all that are kept agree."""
    place, most, largest = -1, 0, 0.0
    for i in range(n):
        if not kept[i]:
            continue
        count, total = 0, 0.0
        for j in range(n):
            if kept[j] and excess[i, j] > 0.0:
                count += 1
                total += excess[i, j]
        if count > most or (count == most and count > 0 and total >= largest):
            place, most, largest = i, count, total
    return place


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
    for k in range(len(exposure_start) - 1):
        n = 0
        for row in range(exposure_start[k], exposure_start[k + 1]):
            accepted[row] = False
            if matched[row]:
                rows[n], kept[n], excess[n, n] = row, True, 0.0
                n += 1
        if small and _agree(s_d, s_i, rows, n, tolerance):
            for i in range(n):
                accepted[rows[i]] = True
            continue
        for i in range(n):
            for j in range(i):
                error = abs(_arclength(s_d, rows[i], rows[j]) - _arclength(s_i, rows[i], rows[j]))
                excess[i, j] = excess[j, i] = error - tolerance
        place = _worst(excess, kept, n)
        while place >= 0:
            kept[place] = False
            place = _worst(excess, kept, n)
        for i in range(n):
            accepted[rows[i]] = kept[i]
