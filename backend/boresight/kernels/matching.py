"""Association of detections with catalogue stars as compiled loops; `sky.matching` derives the method and is the one caller.

Everything is written in the right-handed triad of D (parity is the caller's). For a detection with measured direction s, tangent
vectors e1, e2 (e1 x e2 = s) and a star seen at C c, the residual r = [e1 e2]^T (s - C c) obeys, to first order,

    r = A y + noise,   y = (theta, w),   A = [ -e2^T, -e1^T G ; e1^T, -e2^T G ],   noise ~ sigma^2 I

where theta turns C (C_true = (I - [theta]x) C) and w ~ N(0, I) are the parameters' errors in units of the square root
of their covariance, G = ds/dx P^(1/2). A depends on the detection alone, so one factor of the information Lambda = sum
A^T A / sigma^2 serves every candidate. `tests/sky/test_matching.py` holds the loops against plain NumPy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from boresight.kernels.compilation import FAST, loop, part

#: Why a detection has no match, in the order of `sky.matching.ROW_REASONS`.
MATCHED, NO_STAR, AMBIGUOUS, TOO_WIDE, DISAGREES, NO_ATTITUDE, FEW_STARS = 0, 1, 2, 3, 4, 5, 6
#: Where an attitude came from, in the order of `sky.matching.STARTS`.
NO_START, GIVEN, OTHER_EXPOSURE = 0, 1, 2
#: Information of a start attitude that only served to find the first stars, 1/rad^2.
_DIFFUSE = 100.0
#: Difference of two candidates' d^2 (twice the log of their likelihood ratio) below which they cannot be told apart.
_TELL_APART = 9.0
#: Expected number of chance stars inside a gate above which a star is not taken by it.
_CHANCE = 0.03
#: Arcs may differ by this much at most while a first set of stars is sought in a wide field, rad.
_SEARCH_ARC = 3e-3
#: A star that the file names is believed with so many times the stated centroid noise, for that may be understated; what
#: the parameters may be off by is not widened, or a wrong name would pass under a ground calibration.
_GIVEN_NOISE = 3.0
_SEARCH_STARS = 4
_SIBLING_STARS = 3
_SEARCH_ASSOCIATIONS = 400
_SIBLING_RADIUS = 0.03
#: A first-order prediction errs by this share of the correction that it makes: 2 px where a ground calibration is 20 px off.
_CURVATURE = 0.1

_part = part(fastmath=FAST)


class Scratch(NamedTuple):
    """Space that the loops write in, made once for all frames: none of them asks for memory in between."""

    f0: np.ndarray  # (d,), as f1: a row of A turned by the factor
    f1: np.ndarray
    r: np.ndarray  # (2,)
    best: np.ndarray  # (most,) of detections, as the eight that follow
    rival: np.ndarray
    area: np.ndarray
    spread: np.ndarray
    believed: np.ndarray
    place: np.ndarray
    held: np.ndarray
    before: np.ndarray
    held_use: np.ndarray
    triads: np.ndarray  # (2, 3, 3)
    three: np.ndarray  # (3, 3)
    factor: np.ndarray  # (3, 3)
    wide: np.ndarray  # (d + 1, 3)
    column: np.ndarray  # (3,)
    row: np.ndarray  # (3,)
    plane: np.ndarray  # (3, 3): axis, east, north
    fit: np.ndarray  # (2, 3)
    attitude: np.ndarray  # (3, 3)
    twin: np.ndarray  # (n_stars,)
    turned: np.ndarray  # (n_stars, 3)
    detection: np.ndarray  # (associations,), as the three that follow
    candidate: np.ndarray
    votes: np.ndarray
    order: np.ndarray
    agree: np.ndarray  # (associations, associations)


def scratch(most: int, d: int, n_stars: int) -> Scratch:
    """Make the space for exposures of `most` detections at most, d unknowns and so many guide stars."""
    associations = _SEARCH_ASSOCIATIONS
    return Scratch(
        np.empty(d), np.empty(d), np.empty(2),
        np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most),
        np.empty(most, np.int64), np.empty(most, np.bool_), np.empty(most, np.bool_), np.empty(most, np.bool_),
        np.empty((2, 3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((d + 1, 3)), np.empty(3), np.empty(3),
        np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 3)), np.empty(n_stars, np.int64), np.empty((n_stars, 3)),
        np.empty(associations, np.int64), np.empty(associations, np.int64), np.empty(associations, np.int64),
        np.empty(associations, np.int64), np.empty((associations, associations), np.bool_),
    )  # fmt: skip


@_part
def _copy(source, target):
    """Copy (n,) numbers; to assign a slice takes a hundred times as long to compile, for it minds overlap and shapes."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@_part
def _copy_square(source, target):
    """Copy (n, n) numbers."""
    for i in range(source.shape[0]):
        for j in range(source.shape[0]):
            target[i, j] = source[i, j]


@_part
def _angle(ax, ay, az, bx, by, bz):
    """Angle between unit vectors, exact at every separation."""
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), ax * bx + ay * by + az * bz)


@_part
def _rows(s, G, A, T):
    """Fill A (n, 2, 3 + p) and the tangent vectors T (n, 2, 3) of detections s (n, 3) with G (n, 3, p)."""
    p = G.shape[2]
    for i in range(s.shape[0]):
        x, y, z = s[i, 0], s[i, 1], s[i, 2]
        # e1 along rows, made orthogonal to s; stars lie near the z axis
        norm = 1.0 / math.sqrt(x * x + z * z)
        T[i, 0, 0], T[i, 0, 1], T[i, 0, 2] = z * norm, 0.0, -x * norm
        T[i, 1, 0] = y * T[i, 0, 2]
        T[i, 1, 1] = z * T[i, 0, 0] - x * T[i, 0, 2]
        T[i, 1, 2] = -y * T[i, 0, 0]
        for a in range(3):
            A[i, 0, a] = -T[i, 1, a]
            A[i, 1, a] = T[i, 0, a]
        for q in range(p):
            for row in range(2):
                A[i, row, 3 + q] = -(T[i, row, 0] * G[i, 0, q] + T[i, row, 1] * G[i, 1, q] + T[i, row, 2] * G[i, 2, q])


@_part
def _arcs_agree(s, G, sigma, i, j, c, k, q, gate, widest):
    """Whether the arc of detections i, j is that of the stars c[k], c[q], inside gate sigma of its variance and `widest` rad.

    The variance holds centroid noise and parameter uncertainty; where the noise alone covers the difference the rest is
    not worked out. The difference is taken from the cosines: d phi = -d cos / sin to second order, corrected by the
    arc's own cosine.
    """
    cosine = s[i, 0] * s[j, 0] + s[i, 1] * s[j, 1] + s[i, 2] * s[j, 2]
    star = c[k, 0] * c[q, 0] + c[k, 1] * c[q, 1] + c[k, 2] * c[q, 2]
    sine2 = 1.0 - cosine * cosine
    if sine2 < 1e-12:
        return False
    sine = math.sqrt(sine2)
    excess = (star - cosine) / sine
    excess *= 1.0 + 0.5 * excess * cosine / sine
    if abs(excess) > widest:
        return False
    variance = sigma[i] * sigma[i] + sigma[j] * sigma[j]
    if excess * excess <= gate * gate * variance:
        return True
    for w in range(G.shape[2]):
        slope = 0.0
        for a in range(3):
            slope += (s[j, a] - cosine * s[i, a]) * G[i, a, w] + (s[i, a] - cosine * s[j, a]) * G[j, a, w]
        variance += slope * slope / sine2
    return excess * excess <= gate * gate * variance


@_part
def _disagreements(s, G, sigma, c, use, gate, bad):
    """Count in `bad` (n,) with how many of the used others each used star's arc disagrees; c (n, 3) are the stars' directions."""
    n = s.shape[0]
    bad[:n] = 0
    for i in range(n):
        if not use[i]:
            continue
        for j in range(i):
            if use[j] and not _arcs_agree(s, G, sigma, i, j, c, i, j, gate, np.inf):
                bad[i] += 1
                bad[j] += 1


@_part
def _verify(s, G, sigma, c, use, named, gate, bad, work):
    """Drop stars whose arcs disagree with more than half of the others, the worst first; returns how many stay."""
    n = s.shape[0]
    count = 0
    believed = work.believed
    for i in range(n):
        believed[i] = _GIVEN_NOISE * sigma[i] if named[i] else sigma[i]
        if use[i]:
            count += 1
    _disagreements(s, G, believed, c, use, gate, bad)
    while count >= 2:
        worst = -1
        for i in range(n):
            if use[i] and 2 * bad[i] > count - 1 and (worst < 0 or bad[i] > bad[worst]):
                worst = i
        if worst < 0:
            break
        use[worst] = False
        count -= 1
        for i in range(n):
            a, b = max(i, worst), min(i, worst)
            if use[i] and not _arcs_agree(s, G, believed, a, b, c, a, b, gate, np.inf):
                bad[i] -= 1
    return count


@_part
def _make_triad(ax, ay, az, bx, by, bz, F):
    """Fill F (3, 3) with an orthonormal triad whose first row is a and whose third is along a x b."""
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    norm = 1.0 / math.sqrt(cx * cx + cy * cy + cz * cz)
    F[0, 0], F[0, 1], F[0, 2] = ax, ay, az
    F[2, 0], F[2, 1], F[2, 2] = cx * norm, cy * norm, cz * norm
    F[1, 0] = F[2, 1] * az - F[2, 2] * ay
    F[1, 1] = F[2, 2] * ax - F[2, 0] * az
    F[1, 2] = F[2, 0] * ay - F[2, 1] * ax


@_part
def _wahba(s, c, weight, use, C, work):
    """Fill C (3, 3) with the rotation that best turns directions c into s; False when the used stars do not fix it.

    From the triad of two far stars, Newton steps on Wahba's cost -sum w s.(C c): gradient sum w s_hat x s, Hessian
    sum w ((s.s_hat) I - (s s_hat^T + s_hat s^T) / 2); three times cheaper than a singular value decomposition and the same answer.
    """
    n = s.shape[0]
    i, j, least = -1, -1, 1.0 - 1e-7
    for k in range(n):
        if use[k]:
            if i < 0:
                i = k
            else:
                cosine = s[i, 0] * s[k, 0] + s[i, 1] * s[k, 1] + s[i, 2] * s[k, 2]
                if cosine < least:
                    j, least = k, cosine
    if j < 0:
        return False
    F, E = work.triads[0], work.triads[1]
    _make_triad(s[i, 0], s[i, 1], s[i, 2], s[j, 0], s[j, 1], s[j, 2], F)
    _make_triad(c[i, 0], c[i, 1], c[i, 2], c[j, 0], c[j, 1], c[j, 2], E)
    for a in range(3):
        for b in range(3):
            C[a, b] = F[0, a] * E[0, b] + F[1, a] * E[1, b] + F[2, a] * E[2, b]
    for _ in range(4):
        gx, gy, gz, hxx, hxy, hxz, hyy, hyz, hzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            if not use[k]:
                continue
            x = C[0, 0] * c[k, 0] + C[0, 1] * c[k, 1] + C[0, 2] * c[k, 2]
            y = C[1, 0] * c[k, 0] + C[1, 1] * c[k, 1] + C[1, 2] * c[k, 2]
            z = C[2, 0] * c[k, 0] + C[2, 1] * c[k, 1] + C[2, 2] * c[k, 2]
            w, u, v, t = weight[k], s[k, 0], s[k, 1], s[k, 2]
            gx += w * (y * t - z * v)
            gy += w * (z * u - x * t)
            gz += w * (x * v - y * u)
            hxx += w * (y * v + z * t)
            hyy += w * (x * u + z * t)
            hzz += w * (x * u + y * v)
            hxy -= 0.5 * w * (x * v + y * u)
            hxz -= 0.5 * w * (x * t + z * u)
            hyz -= 0.5 * w * (y * t + z * v)
        kxx, kxy, kxz = hyy * hzz - hyz * hyz, hxz * hyz - hxy * hzz, hxy * hyz - hxz * hyy
        determinant = hxx * kxx + hxy * kxy + hxz * kxz
        if not determinant > 0.0:
            return False
        kyy, kyz, kzz = hxx * hzz - hxz * hxz, hxy * hxz - hxx * hyz, hxx * hyy - hxy * hxy
        px = (kxx * gx + kxy * gy + kxz * gz) / determinant
        py = (kxy * gx + kyy * gy + kyz * gz) / determinant
        pz = (kxz * gx + kyz * gy + kzz * gz) / determinant
        _turn(C, px, py, pz)
        if px * px + py * py + pz * pz < 1e-26:
            break
    return True


@_part
def _turn(C, px, py, pz):
    """Turn C by the rotation vector p, by its quaternion (p / 2, 1) made unit: right to third order, and always a rotation."""
    x, y, z = 0.5 * px, 0.5 * py, 0.5 * pz
    norm = 1.0 / (1.0 + x * x + y * y + z * z)
    for b in range(3):
        u, v, w = C[0, b], C[1, b], C[2, b]
        tx, ty, tz = y * w - z * v, z * u - x * w, x * v - y * u
        C[0, b] = u + 2.0 * norm * (tx + y * tz - z * ty)
        C[1, b] = v + 2.0 * norm * (ty + z * tx - x * tz)
        C[2, b] = w + 2.0 * norm * (tz + x * ty - y * tx)


@_part
def _factor(Lambda, L, d):
    """Lower Cholesky factor of the leading (d, d) of Lambda, its diagonal kept inverted; False when not positive definite."""
    for j in range(d):
        for i in range(j, d):
            value = Lambda[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            if i == j:
                if not value > 0.0:
                    return False
                L[j, j] = 1.0 / math.sqrt(value)
            else:
                L[i, j] = value * L[j, j]
    return True


@_part
def _forward(L, b, d, x):
    """Solve L x = b."""
    for i in range(d):
        value = b[i]
        for k in range(i):
            value -= L[i, k] * x[k]
        x[i] = value * L[i, i]


@_part
def _backward(L, b, d, x):
    """Solve L^T x = b."""
    for i in range(d - 1, -1, -1):
        value = b[i]
        for k in range(i + 1, d):
            value -= L[k, i] * x[k]
        x[i] = value * L[i, i]


@_part
def _variance(sigma, r0, r1):
    """Variance of one axis of a residual: centroid noise, and the curvature that a correction of this size leaves out."""
    return sigma * sigma + _CURVATURE * _CURVATURE * (r0 * r0 + r1 * r1)


@_part
def _add(Lambda, eta, A, r0, r1, weight, d):
    """Take a detection into the information; a negative weight takes it out."""
    for i in range(d):
        eta[i] += weight * (A[0, i] * r0 + A[1, i] * r1)
        for j in range(i + 1):
            Lambda[i, j] += weight * (A[0, i] * A[0, j] + A[1, i] * A[1, j])


@_part
def _marginal(Lambda, eta, d, L, M, m, work):
    """Information on w alone after the attitude is eliminated: M (p, p) and m (p,)."""
    p = d - 3
    _factor(Lambda, L, 3)
    columns = work.wide
    for q in range(p):
        _forward(L, Lambda[3 + q, :3], 3, columns[q])
    _forward(L, eta[:3], 3, columns[p])
    for q in range(p):
        m[q] = eta[3 + q]
        for a in range(3):
            m[q] -= columns[q, a] * columns[p, a]
        for k in range(q + 1):
            value = Lambda[3 + q, 3 + k]
            for a in range(3):
                value -= columns[q, a] * columns[k, a]
            M[q, k] = value
            M[k, q] = value


@_part
def _residual(s, T, C, c, r):
    """Fill r (2,) with the residual of one detection against a star at ICRS direction c."""
    x = s[0] - (C[0, 0] * c[0] + C[0, 1] * c[1] + C[0, 2] * c[2])
    y = s[1] - (C[1, 0] * c[0] + C[1, 1] * c[1] + C[1, 2] * c[2])
    z = s[2] - (C[2, 0] * c[0] + C[2, 1] * c[1] + C[2, 2] * c[2])
    r[0] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z
    r[1] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z


@_part
def _refract(c, air):
    """Bend direction c (3,) towards the zenith air[:3] by A tan Z + B tan^3 Z, A and B the last of air (5,): as `erfa.atioq` does.

    Z is observed and c is not, hence one Newton step; the sine and the cosine of the elevation are kept from zero.
    """
    along = c[0] * air[0] + c[1] * air[1] + c[2] * air[2]
    across2 = 1.0 - along * along
    across = math.sqrt(across2) if across2 > 1e-12 else 1e-6
    high = max(along, 0.05)
    tangent = across / high
    w = air[4] * tangent * tangent
    turn = (air[3] + w) * tangent / (1.0 + (air[3] + 3.0 * w) / (high * high))
    cosine = 1.0 - 0.5 * turn * turn
    shrunk = cosine - turn * high / across
    raised = cosine * along + turn * across - shrunk * along
    for a in range(3):
        c[a] = shrunk * c[a] + raised * air[a]
    norm = 1.0 / math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    for a in range(3):
        c[a] *= norm


@_part
def _apparent(place, motion, parallax, j, years, earth, beta, air, c):
    """Direction in which guide star j is seen: motion, parallax, aberration (`sky.apparent`), and air where there is any."""
    norm = 0.0
    for a in range(3):
        c[a] = place[j, a] + years * motion[j, a] - parallax[j] * earth[a]
        norm += c[a] * c[a]
    norm = 1.0 / math.sqrt(norm)
    along, speed2 = 0.0, 0.0
    for a in range(3):
        c[a] *= norm
        along += c[a] * beta[a]
        speed2 += beta[a] * beta[a]
    slow = math.sqrt(1.0 - speed2)
    push = 1.0 + along / (1.0 + slow)
    norm = 0.0
    for a in range(3):
        c[a] = slow * c[a] + push * beta[a]
        norm += c[a] * c[a]
    norm = 1.0 / math.sqrt(norm)
    for a in range(3):
        c[a] *= norm
    if air[3] > 0.0:
        _refract(c, air)


@_part
def _first_from(place, low):
    """Return the first guide star whose z component is at least `low`."""
    first, last = 0, place.shape[0]
    while first < last:
        middle = (first + last) // 2
        if place[middle, 2] < low:
            first = middle + 1
        else:
            last = middle
    return first


@_part
def _candidates(axis, cone, place, motion, parallax, years, earth, beta, air, star, c):
    """Fill star (m,) and c (m, 3) with the guide stars inside a cone; guide stars ascend in declination. Returns m."""
    declination = math.asin(min(1.0, max(-1.0, axis[2])))
    low, high = math.sin(max(-math.pi / 2, declination - cone)), math.sin(min(math.pi / 2, declination + cone))
    if declination - cone <= -math.pi / 2:
        low = -1.0
    if declination + cone >= math.pi / 2:
        high = 1.0
    nearest = math.cos(cone)
    m = 0
    for j in range(_first_from(place, low), place.shape[0]):
        if place[j, 2] > high:
            break
        if place[j, 0] * axis[0] + place[j, 1] * axis[1] + place[j, 2] * axis[2] > nearest and m < star.shape[0]:
            star[m] = j
            _apparent(place, motion, parallax, j, years, earth, beta, air, c[m])
            m += 1
    return m


@_part
def _onto_given(m, star, c, hip, given, given_s, own, sigma, work):
    """Bring catalogue directions onto those the file gives: replace stars it names, move the others by the same affine map.

    A file's own directions may hold what the catalogue's do not, such as refraction. The map is fitted in the tangent
    plane on the stars that have both; where it does not fit within the noise, only stars that the file names stay.
    Returns the new m.
    """
    n = given.shape[0]
    twin = work.twin
    for k in range(m):
        twin[k] = -1
    pairs, widest, typical = 0, 0.0, 0.0
    for i in range(n):
        if given[i] <= 0 or math.isnan(given_s[i, 0]):
            continue
        for k in range(m):
            if hip[star[k]] == given[i]:
                twin[k] = i
                if own[i]:
                    pairs += 1
                    widest = max(widest, _angle(c[k, 0], c[k, 1], c[k, 2], given_s[i, 0], given_s[i, 1], given_s[i, 2]))
                    typical += sigma[i]
                break
    if pairs > 0 and widest > 0.1 * typical / pairs:
        fits = pairs >= 6 and _affine(m, c, given_s, twin, own, typical / pairs, work)
        if not fits:
            kept = 0
            for k in range(m):
                if twin[k] >= 0:
                    star[kept], twin[kept] = star[k], twin[k]
                    _copy(c[k], c[kept])
                    kept += 1
            m = kept
    for k in range(m):
        if twin[k] >= 0:
            _copy(given_s[twin[k]], c[k])
    return m


@_part
def _tangent_plane(m, c, twin, own, plane):
    """Fill plane (3, 3) with the mean of the directions that have a twin of the file's own, and with east and north of it."""
    axis, east, north = plane[0], plane[1], plane[2]
    axis[:] = 0.0
    for k in range(m):
        if twin[k] >= 0 and own[twin[k]]:
            for a in range(3):
                axis[a] += c[k, a]
    norm = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    for a in range(3):
        axis[a] /= norm
    across = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1])
    if across < 1e-6:
        east[0], east[1], east[2] = 1.0, 0.0, 0.0
    else:
        east[0], east[1], east[2] = -axis[1] / across, axis[0] / across, 0.0
    north[0] = axis[1] * east[2] - axis[2] * east[1]
    north[1] = axis[2] * east[0] - axis[0] * east[2]
    north[2] = axis[0] * east[1] - axis[1] * east[0]


@_part
def _along(c, k, axis):
    """Component of direction k along an axis."""
    return c[k, 0] * axis[0] + c[k, 1] * axis[1] + c[k, 2] * axis[2]


@_part
def _affine(m, c, given_s, twin, own, sigma, work):
    """Move all c by the affine map of the tangent plane that brings twins onto given directions; False where it does not fit."""
    _tangent_plane(m, c, twin, own, work.plane)
    east, north, N, fit, row = work.plane[1], work.plane[2], work.three, work.fit, work.row
    N[:] = 0.0
    fit[:] = 0.0
    for k in range(m):
        i = twin[k]
        if i >= 0 and own[i]:
            row[0], row[1], row[2] = 1.0, _along(c, k, east), _along(c, k, north)
            dx, dy = _along(given_s, i, east) - row[1], _along(given_s, i, north) - row[2]
            for a in range(3):
                fit[0, a] += row[a] * dx
                fit[1, a] += row[a] * dy
                for b in range(a + 1):
                    N[a, b] += row[a] * row[b]
    for a in range(3):
        N[a, a] += 1e-12
    if not _factor(N, work.factor, 3):
        return False
    for coordinate in range(2):
        _forward(work.factor, fit[coordinate], 3, work.column)
        _backward(work.factor, work.column, 3, fit[coordinate])
    total, pairs = 0.0, 0
    for k in range(m):
        row[0], row[1], row[2] = 1.0, _along(c, k, east), _along(c, k, north)
        dx = row[0] * fit[0, 0] + row[1] * fit[0, 1] + row[2] * fit[0, 2]
        dy = row[0] * fit[1, 0] + row[1] * fit[1, 1] + row[2] * fit[1, 2]
        i = twin[k]
        if i >= 0 and own[i]:
            total += (_along(given_s, i, east) - row[1] - dx) ** 2 + (_along(given_s, i, north) - row[2] - dy) ** 2
            pairs += 1
        norm = 0.0
        for a in range(3):
            c[k, a] += dx * east[a] + dy * north[a]
            norm += c[k, a] * c[k, a]
        norm = math.sqrt(norm)
        for a in range(3):
            c[k, a] /= norm
    return total / pairs < sigma * sigma


@_part
def _by_votes(votes, total, order):
    """Fill `order` with the first `total` associations, most votes first, equal ones as they come."""
    for a in range(total):
        place = a
        while place > 0 and votes[order[place - 1]] < votes[a]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = a


@_part
def _search(s, G, sigma, C, radius, m, c, gate, use, chosen, work):
    """Find a first set of stars near a start attitude: associations vote for one another by their arcs (geometric voting).

    Fills use (n,) and chosen (n,) = candidate. Returns the size of the largest set in which all arcs agree.
    """
    n = s.shape[0]
    detection, candidate, turned = work.detection, work.candidate, work.turned
    total = 0
    for k in range(m):
        for a in range(3):
            turned[k, a] = C[a, 0] * c[k, 0] + C[a, 1] * c[k, 1] + C[a, 2] * c[k, 2]
    near = math.cos(radius)
    for i in range(n):
        for k in range(m):
            if (
                s[i, 0] * turned[k, 0] + s[i, 1] * turned[k, 1] + s[i, 2] * turned[k, 2] > near
                and total < _SEARCH_ASSOCIATIONS
            ):
                detection[total], candidate[total] = i, k
                total += 1
    agree, votes = work.agree, work.votes
    for a in range(total):
        votes[a] = 0
        for b in range(a):
            agree[a, b] = False
            agree[b, a] = False
            i, j, k, q = detection[a], detection[b], candidate[a], candidate[b]
            if i == j or k == q:
                continue
            if _arcs_agree(s, G, sigma, i, j, c, k, q, gate, _SEARCH_ARC):
                agree[a, b] = True
                agree[b, a] = True
                votes[a] += 1
                votes[b] += 1
    order = work.order
    _by_votes(votes, total, order)
    best = 0
    members, held = work.place, work.held
    for seed in range(min(total, 12)):
        size = 1
        members[0] = order[seed]
        held[:n] = False
        held[detection[order[seed]]] = True
        for place in range(total):
            a = order[place]
            if held[detection[a]]:
                continue
            fits = True
            for b in range(size):
                if not agree[a, members[b]]:
                    fits = False
                    break
            if fits:
                members[size] = a
                held[detection[a]] = True
                size += 1
        if size > best:
            best = size
            use[:n] = False
            for b in range(size):
                use[detection[members[b]]] = True
                chosen[detection[members[b]]] = candidate[members[b]]
    return best


@_part
def _grow(s, T, A, sigma, C, m, c, turned, taken, density, gate, Lambda, eta, use, chosen, reason, L, y, work):
    """Take in detection after detection, the best predicted first; returns False when the information is not positive definite."""
    n, d = s.shape[0], A.shape[2]
    f0, f1, r = work.f0, work.f1, work.r
    best, rival, place, area, spread = work.best, work.rival, work.place, work.area, work.spread
    for k in range(m):
        for a in range(3):
            turned[k, a] = C[a, 0] * c[k, 0] + C[a, 1] * c[k, 1] + C[a, 2] * c[k, 2]
    while True:
        if not _factor(Lambda, L, d):
            return False
        _forward(L, eta, d, f0)
        _backward(L, f0, d, y)
        narrowest = np.inf
        for i in range(n):
            if use[i]:
                continue
            _forward(L, A[i, 0], d, f0)
            _forward(L, A[i, 1], d, f1)
            p0, p1 = 0.0, 0.0
            for q in range(d):
                p0 += A[i, 0, q] * y[q]
                p1 += A[i, 1, q] * y[q]
            v00 = _variance(sigma[i], p0, p1)
            v01, v11 = 0.0, v00
            for q in range(d):
                v00 += f0[q] * f0[q]
                v01 += f0[q] * f1[q]
                v11 += f1[q] * f1[q]
            determinant = v00 * v11 - v01 * v01
            area[i] = math.pi * gate * gate * math.sqrt(determinant)
            spread[i] = v00 + v11
            best[i], rival[i], place[i] = np.inf, np.inf, -1
            reach2 = gate * gate * (v00 + v11)  # v00 + v11 is no less than the larger eigenvalue
            px = s[i, 0] - p0 * T[i, 0, 0] - p1 * T[i, 1, 0]
            py = s[i, 1] - p0 * T[i, 0, 1] - p1 * T[i, 1, 1]
            pz = s[i, 2] - p0 * T[i, 0, 2] - p1 * T[i, 1, 2]
            for k in range(m):
                dx, dy, dz = px - turned[k, 0], py - turned[k, 1], pz - turned[k, 2]
                if dx * dx + dy * dy + dz * dz > reach2 or taken[k]:
                    continue
                r0 = T[i, 0, 0] * dx + T[i, 0, 1] * dy + T[i, 0, 2] * dz
                r1 = T[i, 1, 0] * dx + T[i, 1, 1] * dy + T[i, 1, 2] * dz
                d2 = (v11 * r0 * r0 - 2.0 * v01 * r0 * r1 + v00 * r1 * r1) / determinant
                if d2 < best[i]:
                    rival[i], best[i], place[i] = best[i], d2, k
                elif d2 < rival[i]:
                    rival[i] = d2
            if place[i] < 0 or best[i] > gate * gate:
                reason[i] = NO_STAR
                place[i] = -1
            elif rival[i] < min(best[i] + _TELL_APART, gate * gate):
                reason[i] = AMBIGUOUS
                place[i] = -1
            elif density * area[i] > _CHANCE:
                reason[i] = TOO_WIDE
                place[i] = -1
            else:
                narrowest = min(narrowest, spread[i])
        added = False
        for i in range(n):
            if use[i] or place[i] < 0 or spread[i] > max(2.0 * narrowest, 8.0 * sigma[i] * sigma[i]):
                continue
            k = place[i]
            contested = taken[k]
            for j in range(n):
                if j != i and not use[j] and place[j] == k and best[j] < best[i] + _TELL_APART:
                    contested = True
            if contested:
                reason[i] = AMBIGUOUS
                continue
            _residual(s[i], T[i], C, c[k], r)
            _add(Lambda, eta, A[i], r[0], r[1], 1.0 / _variance(sigma[i], r[0], r[1]), d)
            use[i], chosen[i], reason[i] = True, k, MATCHED
            taken[k] = True
            added = True
        if not added:
            return True


@_part
def _prune(s, T, A, sigma, C, c, named, gate, Lambda, eta, use, reason, tolerance, L, y, work):
    """Drop stars that the joint fit of all the others rejects, the worst first; c (n, 3) are the stars' directions.

    Fills `tolerance` (n,) with the gate about the place that the others predict for each star that stays, rad.
    """
    n, d = s.shape[0], A.shape[2]
    f0, f1, r = work.f0, work.f1, work.r
    while True:
        if not _factor(Lambda, L, d):
            return False
        _forward(L, eta, d, f0)
        _backward(L, f0, d, y)
        worst, worst_d2 = -1, gate * gate
        for i in range(n):
            if not use[i]:
                continue
            _forward(L, A[i, 0], d, f0)
            _forward(L, A[i, 1], d, f1)
            _residual(s[i], T[i], C, c[i], r)
            variance = _variance(sigma[i], r[0], r[1])
            v00, v01, v11, r0, r1 = variance, 0.0, variance, r[0], r[1]
            for q in range(d):
                v00 -= f0[q] * f0[q]
                v01 -= f0[q] * f1[q]
                v11 -= f1[q] * f1[q]
                r0 -= A[i, 0, q] * y[q]
                r1 -= A[i, 1, q] * y[q]
            determinant = v00 * v11 - v01 * v01
            tolerance[i] = gate * variance * math.sqrt(2.0 / max(v00 + v11, 1e-6 * variance))
            if determinant < 1e-6 * variance * variance or v00 <= 0.0:
                continue
            if named[i]:
                # S with the star's own noise widened by e is S + e S^2 / variance^2 (matrix inversion lemma)
                q = (_GIVEN_NOISE * _GIVEN_NOISE - 1.0) * sigma[i] * sigma[i] / (variance * variance)
                trace = v00 + v11
                v00, v01, v11 = (
                    v00 + q * (v00 * v00 + v01 * v01),
                    v01 + q * v01 * trace,
                    v11 + q * (v01 * v01 + v11 * v11),
                )
                determinant = v00 * v11 - v01 * v01
            d2 = (v11 * r0 * r0 - 2.0 * v01 * r0 * r1 + v00 * r1 * r1) / determinant
            if d2 > worst_d2:
                worst, worst_d2 = i, d2
        if worst < 0:
            return True
        _residual(s[worst], T[worst], C, c[worst], r)
        _add(Lambda, eta, A[worst], r[0], r[1], -1.0 / _variance(sigma[worst], r[0], r[1]), d)
        use[worst] = False
        reason[worst] = DISAGREES


@_part
def _attitude_covariance(A, sigma, use, covariance, work):
    """Covariance of Wahba's attitude, (3, 3) rad^2 about the axes of D: centroid noise, and parameters through the attitude."""
    p = A.shape[2] - 3
    N, M, L, column = work.three, work.wide, work.factor, work.column
    N[:] = 0.0
    M[:] = 0.0
    for i in range(sigma.shape[0]):
        if use[i]:
            weight = 1.0 / (sigma[i] * sigma[i])
            for row in range(2):
                for a in range(3):
                    for b in range(a + 1):
                        N[a, b] += weight * A[i, row, a] * A[i, row, b]
                    for q in range(p):
                        M[q, a] += weight * A[i, row, a] * A[i, row, 3 + q]
    _factor(N, L, 3)
    # [N^-1 M, L^-T]: its product with its transpose is N^-1 M M^T N^-1 + N^-1
    for q in range(p):
        _forward(L, M[q], 3, column)
        _backward(L, column, 3, M[q])
    for q in range(3):
        column[:] = 0.0
        column[q] = 1.0
        _backward(L, column, 3, M[p + q])
    for a in range(3):
        for b in range(3):
            value = 0.0
            for q in range(p + 3):
                value += M[q, a] * M[q, b]
            covariance[a, b] = value


class Seen(NamedTuple):
    """The detections of consecutive frames, (n_rows,) each: what was measured, and what the file says of it."""

    s: np.ndarray
    G: np.ndarray
    sigma: np.ndarray
    weight: np.ndarray
    given: np.ndarray
    given_s: np.ndarray
    own: np.ndarray


class Observer(NamedTuple):
    """When each exposure was made, how fast its observer moved, and the zenith and the air's A and B above it, (n_exposures,)."""

    years: np.ndarray
    earth: np.ndarray
    beta: np.ndarray
    air: np.ndarray  # (n_exposures, 5)


class Guides(NamedTuple):
    """The stars that may be matched with."""

    hip: np.ndarray
    place: np.ndarray
    motion: np.ndarray
    parallax: np.ndarray
    density: float


class Hints(NamedTuple):
    """From where each exposure may start, (n_exposures,): attitude, how far off it may be, and where it came from."""

    attitude: np.ndarray
    radius: np.ndarray
    start: np.ndarray


class Rules(NamedTuple):
    """How is matched: whether rows have directions of their own, whether given matches are believed, and three limits."""

    any_own: bool
    believe: bool
    cone: float
    gate: float
    minimum_stars: int


class AssociationArrays(NamedTuple):
    """What matching says, (n_rows,) and from `start` on (n_exposures,); see `sky.matching.Association`."""

    star_id: np.ndarray
    direction: np.ndarray
    reason: np.ndarray
    tolerance: np.ndarray
    start: np.ndarray
    valid: np.ndarray
    attitude: np.ndarray
    covariance: np.ndarray


class Frame(NamedTuple):
    """What is known of the exposures of the frame at hand, (exposures,) each, and space for one of them."""

    A: np.ndarray  # (exposures, most, 2, d), as T, named and use: of each detection
    T: np.ndarray
    named: np.ndarray
    use: np.ndarray
    solved: np.ndarray
    Lambda: np.ndarray  # (exposures, d, d)
    eta: np.ndarray
    shared: np.ndarray  # (exposures, p, p): what an exposure says of the parameters
    shared_eta: np.ndarray
    total: np.ndarray  # (d, d)
    total_eta: np.ndarray
    L: np.ndarray
    y: np.ndarray
    r: np.ndarray
    bad: np.ndarray  # (most,)
    chosen: np.ndarray
    star: np.ndarray  # (n_stars,): the candidates of an exposure, with `taken` and `c`
    taken: np.ndarray
    c: np.ndarray
    work: Scratch


def frame_space(frame_start: np.ndarray, row_start: np.ndarray, p: int, n_stars: int) -> Frame:
    """Make the space for any of these frames, with p parameters and so many guide stars."""
    d, most, widest = 3 + p, np.diff(row_start).max(initial=0), np.diff(frame_start).max(initial=0)
    return Frame(
        np.empty((widest, most, 2, d)), np.empty((widest, most, 2, 3)),
        np.zeros((widest, most), np.bool_), np.zeros((widest, most), np.bool_), np.zeros(widest, np.bool_),
        np.zeros((widest, d, d)), np.zeros((widest, d)), np.zeros((widest, p, p)), np.zeros((widest, p)),
        np.empty((d, d)), np.empty(d), np.zeros((d, d)), np.empty(d), np.empty(2),
        np.empty(most, np.int64), np.empty(most, np.int64),
        np.empty(n_stars, np.int64), np.empty(n_stars, np.bool_), np.empty((n_stars, 3)), scratch(most, d, n_stars),
    )  # fmt: skip


@loop(
    "i1 i1", (Seen, "f2 f3 f1 f1 i1 f2 b1"), (Observer, "f1 f2 f2 f2"), (Guides, "i1 f2 f2 f1 f"), (Hints, "f3 f1 i1"),
    (Rules, "b b f f i"), (AssociationArrays, "i1 f2 i1 f1 i1 b1 f3 f3"),
    (Frame, "f4 f4 b2 b2 b1 f3 f2 f3 f2 f2 f1 f2 f1 f1 i1 i1 i1 b1 f2", (
        Scratch, "f1 f1 f1 f1 f1 f1 f1 f1 i1 b1 b1 b1 f3 f2 f2 f2 f1 f1 f2 f2 f2 i1 f2 i1 i1 i1 i1 b2",
    )),
    fastmath=FAST, _nrt=False,
)  # fmt: skip
def match_frames(frame_start, row_start, seen, observer, guides, hints, rules, answer, frame):
    """Match the detections of every frame; see `sky.matching.match` for what goes in and comes out.

    Frame k owns the exposures frame_start[k]:frame_start[k + 1], exposure e the rows row_start[e]:row_start[e + 1].
    Each frame starts from the same parameters and their covariance; what its stars say of the parameters' errors serves
    its own exposures only.
    """
    for k in range(frame_start.shape[0] - 1):
        e0, e1 = frame_start[k], frame_start[k + 1]
        for e in range(e0, e1):
            _start_from_given(e, e - e0, row_start[e], row_start[e + 1], seen, rules, answer, frame)
        for e in range(e0, e1):
            q, i0, i1 = e - e0, row_start[e], row_start[e + 1]
            if not frame.solved[q] or _count(frame.use[q], i1 - i0) < min(3, rules.minimum_stars):
                _start_from_hints(e, e0, e1, i0, i1, seen, observer, guides, hints, rules, answer, frame)
        for e in range(e0, e1):
            q, i0, i1 = e - e0, row_start[e], row_start[e + 1]
            frame.shared[q] = 0.0
            frame.shared_eta[q] = 0.0
            if frame.solved[q]:
                _learn(e, q, i0, i1, seen, answer, frame)
        for e in range(e0, e1):
            q, i0, i1 = e - e0, row_start[e], row_start[e + 1]
            if not frame.solved[q]:
                _blank(e, i0, i1, answer)
                continue
            _know(q, e1 - e0, frame)
            _match_exposure(e, q, i0, i1, seen, observer, guides, rules, answer, frame)
            if math.isnan(answer.attitude[e, 0, 0]):
                frame.solved[q] = False
            else:
                _learn(e, q, i0, i1, seen, answer, frame)  # the other exposures learn from all stars of this one


@_part
def _start_from_given(e, q, i0, i1, seen, rules, answer, frame):
    """Attitude of exposure e from its given matches, after they have voted out the wrong ones."""
    s, G, direction, use, named = seen.s[i0:i1], seen.G[i0:i1], answer.direction[i0:i1], frame.use[q], frame.named[q]
    answer.start[e] = NO_START
    frame.solved[q], answer.valid[e] = False, False
    n = i1 - i0
    for i in range(n):
        use[i] = rules.believe and seen.given[i0 + i] > 0 and not math.isnan(seen.given_s[i0 + i, 0])
        named[i] = use[i]
        _copy(seen.given_s[i0 + i], direction[i])
        answer.reason[i0 + i] = NO_ATTITUDE
        answer.star_id[i0 + i] = seen.given[i0 + i] if use[i] else 0
    _rows(s, G, frame.A[q], frame.T[q])
    n_named = _count(use, n)
    agreed = _verify(s, G, seen.sigma[i0:i1], direction, use, named, rules.gate, frame.bad, frame.work)
    # two that agree among many that do not are a coincidence
    if agreed >= 3 or (agreed == 2 and n_named <= 3):
        frame.solved[q] = _wahba(s, direction, seen.weight[i0:i1], use, answer.attitude[e], frame.work)
    if frame.solved[q]:
        answer.start[e] = GIVEN
    else:
        use[:n] = False


@_part
def _start_from_hints(e, e0, e1, i0, i1, seen, observer, guides, hints, rules, answer, frame):
    """Attitude of exposure e from the frame's other exposure, else from its hint; what the given matches said stands otherwise."""
    q, use, attitude = e - e0, frame.use[e - e0], answer.attitude[e]
    fallback, fallback_use, fallback_attitude = frame.solved[q], frame.work.held_use, frame.work.attitude
    _copy(use, fallback_use)
    _copy_square(attitude, fallback_attitude)
    found = False
    for other in range(e0, e1):
        if other != e and frame.solved[other - e0] and answer.start[other] != NO_START:
            _copy_square(answer.attitude[other], attitude)
            found = True
    if found:
        found = _vote(
            e, q, i0, i1, _SIBLING_RADIUS, OTHER_EXPOSURE, _SIBLING_STARS, seen, observer, guides, rules, answer, frame
        )
    if not found and hints.start[e] != NO_START:
        _copy_square(hints.attitude[e], attitude)
        _vote(
            e, q, i0, i1, hints.radius[e], hints.start[e], _SEARCH_STARS, seen, observer, guides, rules, answer, frame
        )
    if fallback and not frame.solved[q]:
        frame.solved[q], answer.start[e] = True, GIVEN
        _copy(fallback_use, use)
        _copy_square(fallback_attitude, attitude)
        for i in range(i0, i1):
            answer.star_id[i] = seen.given[i]
            _copy(seen.given_s[i], answer.direction[i])


@_part
def _vote(e, q, i0, i1, radius, kind, wanted, seen, observer, guides, rules, answer, frame):
    """Find the first stars of exposure e by voting about where its attitude says, at least so many; whether that solved it."""
    s, sigma, use, attitude = seen.s[i0:i1], seen.sigma[i0:i1], frame.use[q], answer.attitude[e]
    m = _near(e, i0, i1, rules.cone + radius, seen, observer, guides, rules, answer, frame)
    c, chosen = frame.c, frame.chosen
    found = _search(s, seen.G[i0:i1], sigma, attitude, radius, m, c, rules.gate, use, chosen, frame.work)
    if found < wanted:
        use[: i1 - i0] = False
        frame.solved[q] = False
        answer.start[e] = NO_START
        return False
    for i in range(i1 - i0):
        if use[i]:
            answer.star_id[i0 + i] = guides.hip[frame.star[chosen[i]]]
            _copy(c[chosen[i]], answer.direction[i0 + i])
    frame.solved[q] = _wahba(s, answer.direction[i0:i1], seen.weight[i0:i1], use, attitude, frame.work)
    if frame.solved[q]:
        answer.start[e] = kind
    return frame.solved[q]


@_part
def _near(e, i0, i1, cone, seen, observer, guides, rules, answer, frame):
    """List the guide stars within `cone` of the boresight of exposure e, with their directions; returns how many."""
    m = _candidates(
        answer.attitude[e, 2], cone, guides.place, guides.motion, guides.parallax, observer.years[e], observer.earth[e],
        observer.beta[e], observer.air[e], frame.star, frame.c,
    )  # fmt: skip
    if rules.any_own:
        m = _onto_given(
            m, frame.star, frame.c, guides.hip, seen.given[i0:i1], seen.given_s[i0:i1], seen.own[i0:i1], seen.sigma[i0:i1],
            frame.work,
        )  # fmt: skip
    return m


@_part
def _learn(e, q, i0, i1, seen, answer, frame):
    """Take what the used stars of exposure e say of attitude and parameters, and of the parameters alone."""
    Lambda, eta, r = frame.Lambda[q], frame.eta[q], frame.r
    d = eta.shape[0]
    Lambda[:] = 0.0
    eta[:] = 0.0
    for a in range(3):
        Lambda[a, a] = _DIFFUSE
    for i in range(i1 - i0):
        if frame.use[q, i]:
            _residual(seen.s[i0 + i], frame.T[q, i], answer.attitude[e], answer.direction[i0 + i], r)
            _add(Lambda, eta, frame.A[q, i], r[0], r[1], 1.0 / _variance(seen.sigma[i0 + i], r[0], r[1]), d)
    _marginal(Lambda, eta, d, frame.L, frame.shared[q], frame.shared_eta[q], frame.work)


@_part
def _know(q, n_exposures, frame):
    """Add up what is known when exposure q is matched: its own first stars, the start's parameters, and the other exposures."""
    total, total_eta = frame.total, frame.total_eta
    _copy_square(frame.Lambda[q], total)
    _copy(frame.eta[q], total_eta)
    for a in range(total.shape[0] - 3):
        total[3 + a, 3 + a] += 1.0
        for other in range(n_exposures):
            if other != q and frame.solved[other]:
                total_eta[3 + a] += frame.shared_eta[other, a]
                for b in range(a + 1):
                    total[3 + a, 3 + b] += frame.shared[other, a, b]


@_part
def _blank(e, i0, i1, answer):
    """Say that nothing of exposure e is matched."""
    answer.star_id[i0:i1] = 0
    answer.direction[i0:i1] = np.nan
    answer.attitude[e] = np.nan
    answer.covariance[e] = np.nan


@_part
def _take(i0, n, m, wanted, unwanted, value, guides, answer, frame):
    """Mark the candidates that are the stars of the detections in one mask and not in another as taken, or not."""
    for i in range(n):
        if wanted[i] and not unwanted[i]:
            for j in range(m):
                if guides.hip[frame.star[j]] == answer.star_id[i0 + i]:
                    frame.taken[j] = value


@_part
def _match_exposure(e, q, i0, i1, seen, observer, guides, rules, answer, frame):
    """Match exposure e: drop first stars that the others reject, take further ones, verify, and judge by what the file names."""
    n, work, use, named, before = i1 - i0, frame.work, frame.use[q], frame.named[q], frame.work.before
    s, sigma, A, T, attitude = seen.s[i0:i1], seen.sigma[i0:i1], frame.A[q], frame.T[q], answer.attitude[e]
    star_id, direction, reason = answer.star_id[i0:i1], answer.direction[i0:i1], answer.reason[i0:i1]
    tolerance, total, total_eta, L, y = answer.tolerance[i0:i1], frame.total, frame.total_eta, frame.L, frame.y
    m = _near(e, i0, i1, rules.cone, seen, observer, guides, rules, answer, frame)
    frame.taken[:m] = False
    before[:] = False
    for i in range(n):
        named[i] = use[i] and star_id[i] == seen.given[i0 + i]
        reason[i] = MATCHED if use[i] else NO_STAR
        if use[i]:
            frame.chosen[i] = -1
    _take(i0, n, m, use, before, True, guides, answer, frame)
    _copy(use, before)
    _prune(
        s, T, A, sigma, attitude, direction, named, rules.gate, total, total_eta, use, reason, tolerance, L, y, work
    )  # fmt: skip
    _take(i0, n, m, before, use, False, guides, answer, frame)
    ok = _grow(
        s, T, A, sigma, attitude, m, frame.c, work.turned, frame.taken, guides.density, rules.gate, total, total_eta, use,
        frame.chosen, reason, L, y, work,
    )  # fmt: skip
    for i in range(n):
        if use[i] and not before[i]:
            star_id[i] = guides.hip[frame.star[frame.chosen[i]]]
            _copy(frame.c[frame.chosen[i]], direction[i])
    ok = ok and _prune(
        s, T, A, sigma, attitude, direction, named, rules.gate, total, total_eta, use, reason, tolerance, L, y, work
    )  # fmt: skip
    fewest = n + 1 if not ok else 2 if answer.start[e] <= OTHER_EXPOSURE else rules.minimum_stars
    _finish(
        s, seen.G[i0:i1], A, sigma, seen.weight[i0:i1], named, rules.gate, fewest, use, star_id, direction, reason,
        attitude, answer.covariance[e], frame.bad, work,
    )  # fmt: skip
    if _contradicted(e, q, i0, i1, seen, answer, frame):
        for i in range(n):
            if use[i]:
                reason[i] = DISAGREES
        use[:n] = False
        _blank(e, i0, i1, answer)
    answer.valid[e] = _count(use, n) >= rules.minimum_stars


@_part
def _contradicted(e, q, i0, i1, seen, answer, frame):
    """Whether neither what the file says nor what the detector shows agrees with an attitude from given matches."""
    n_named, n_kept = 0, 0
    for i in range(i0, i1):
        n_named += seen.given[i] > 0 and not math.isnan(seen.given_s[i, 0])
        n_kept += seen.given[i] > 0 and answer.star_id[i] == seen.given[i]
    return answer.start[e] == GIVEN and 2 * n_kept < n_named and 2 * _count(frame.use[q], i1 - i0) < i1 - i0


@_part
def _count(use, n):
    """Number of used stars."""
    count = 0
    for i in range(n):
        if use[i]:
            count += 1
    return count


@_part
def _finish(
    s, G, A, sigma, weight, named, gate, fewest, use, star_id, direction, reason, attitude, covariance, bad, work
):  # fmt: skip
    """Verify all arcs, solve the attitude with what is left, at least `fewest` stars, and blank what is not matched."""
    n = s.shape[0]
    held = work.held
    for i in range(n):
        held[i] = use[i]
    count = _verify(s, G, sigma, direction, use, named, gate, bad, work)
    for i in range(n):
        if held[i] and not use[i]:
            reason[i] = DISAGREES
    if count < fewest or not _wahba(s, direction, weight, use, attitude, work):
        attitude[:] = np.nan
        covariance[:] = np.nan
        for i in range(n):
            if use[i]:
                reason[i] = FEW_STARS
            use[i] = False
    else:
        _attitude_covariance(A[:n], sigma, use, covariance, work)
    for i in range(n):
        if not use[i]:
            star_id[i] = 0
            direction[i] = np.nan
