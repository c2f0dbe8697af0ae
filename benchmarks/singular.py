"""What singular values and all pairs cost a frame, in every form, beside the arcs: W Table 4 in one run, as ratios.

    OPENBLAS_NUM_THREADS=1 python benchmarks/singular.py

W's sensor at its mean numbers of stars, 31, 19 and 8, one linearisation a frame as W has it. The rows are

    svd, angular            the filters of the product, in information form and in the m by m gain form
    .. as printed           gain form with weights 1 / R_rr alone, rows compiled, the m by m inverse by LAPACK
    svd, plain NumPy        the same update as `svd` by `estimation.singular_values` alone
    arcs                    the square-root filter

and the last lines set W's ratio of angular distance to singular values beside ours. Times are the best of several runs; two threads
that share a processor spoil them.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from boresight import kernels
from boresight.estimation import arcs as arcsets
from boresight.estimation import singular_values
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.history import start
from boresight.estimation.filters.information import Frame
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import CHOSEN

PITCH, ROWS, COLUMNS, NOISE_PX = 2.9e-6, 1080, 1920, 0.2
TRUTH = np.array([1.0, 0.016, 970.0, 550.0, -0.5, 0.5])
SCALE = np.array([1e-4, 1e-5, 1.0, 1.0, 0.05, 0.1])
FREE = np.arange(6)
#: W Table 4: mean stars, and time of the angular distance over that of the singular values.
PRINTED = {31: 260.12 / 14.36, 19: 31.12 / 6.88, 8: 4.68 / 2.76}


def star_field(rng, frames, stars):
    """Weighed arcs of frames of so many stars each."""
    n = frames * stars
    row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
    s = PINHOLE_RADIAL.directions(TRUTH, row, col, PITCH).reshape(frames, stars, 3)
    turns = np.linalg.qr(rng.normal(size=(frames, 3, 3)))[0]
    s_i = np.einsum("fnj,fjk->fnk", s, turns).reshape(n, 3)
    star_start = np.arange(frames + 1) * stars
    places, _ = arcsets.order(star_start, s_i)
    field = ArcSet(
        model=PINHOLE_RADIAL.kernel, pitch=PITCH, frame=np.arange(frames), frame_start=np.arange(frames + 1),
        star_start=star_start, row_px=(row + NOISE_PX * rng.normal(size=n))[places],
        col_px=(col + NOISE_PX * rng.normal(size=n))[places], sigma_px=np.full(n, NOISE_PX),
        s_i=np.ascontiguousarray(s_i[places]), source_row=places, phi=np.empty(0), band=np.empty((0, 5)),
    )  # fmt: skip
    return arcsets.weigh(field, arcsets.angular_sigma(PINHOLE_RADIAL, TRUTH, field))[0]


def product(method, form="information"):
    """One of the product's filters over the whole field."""
    tuning = Tuning(linearisations=1, gain_form=form)
    return lambda field: FILTERS[method](field, start(TRUTH, 6, 3.0), FREE, SCALE, tuning)


def printed(method):
    """W's filter: every row with its own variance, and an m by m inverse."""

    def run(field):
        reference = SingularValues(CHOSEN, FREE, SCALE) if method == "svd" else AllPairs(FREE, SCALE)
        sigma_rad = arcsets.angular_sigma(PINHOLE_RADIAL, TRUTH, field)
        z, P, x = np.zeros(6), 9.0 * np.eye(6), TRUTH.copy()
        for k in range(field.n_frames):
            frame = Frame(field, k, sigma_rad)
            reference.weigh(frame.star_start, frame.s_i, frame.sigma_rad)
            e, H = (part[0] for part in reference.unwhitened(*frame.directions(x)))
            measured = np.any(H, axis=1)
            e, H = e[measured], H[measured]
            R = np.full(len(e), sigma_rad[0] ** 2 * (1 if method == "svd" else 2))
            HP = H @ P
            K = HP.T @ np.linalg.inv(HP @ H.T + np.diag(R))
            z, P = z - K @ e, P - K @ HP
            x = TRUTH + SCALE * z

    return run


def plain(field):
    """The filter on singular values by NumPy alone: a decomposition a combination, the covariance, the update."""
    sigma_rad = arcsets.angular_sigma(PINHOLE_RADIAL, TRUTH, field)
    z, information, x = np.zeros(6), np.eye(6) / 9.0, TRUTH.copy()
    for k in range(field.n_frames):
        frame = Frame(field, k, sigma_rad)
        at = PINHOLE_RADIAL.directions_and_jacobian(x, frame.row_px, frame.col_px, PITCH)
        z, information = plain_update(frame, *at, z, information)
        x = TRUTH + SCALE * z


def plain_update(frame, s, D, z, information):
    """One frame of `plain`."""
    taken = singular_values.exposure(frame.s_i, frame.sigma_rad, CHOSEN)
    kept = singular_values.determined_rows(taken.R)
    factor = np.linalg.cholesky(taken.R[np.ix_(kept, kept)])
    values, g = singular_values.stacked(s, taken.rows, CHOSEN)
    H = np.linalg.solve(factor, np.einsum("rnj,njp->rp", g, D)[kept] * SCALE)
    e = np.linalg.solve(factor, (values - taken.z)[kept])
    information = information + H.T @ H
    return z - np.linalg.solve(information, H.T @ e), information


FORMS = {
    "svd, information form": product("svd"),
    "svd, gain form": product("svd", "gain"),
    "svd, as printed": printed("svd"),
    "svd, plain NumPy": plain,
    "angular, information form": product("angular"),
    "angular, gain form": product("angular", "gain"),
    "angular, as printed": printed("angular"),
    "arcs": product("sqrf"),
}
SLOW = {"svd, plain NumPy": 10, "angular, gain form": 10, "angular, as printed": 5}


def update_alone(field, repeats):
    """The SVD update without rays and judgement, compiled and by NumPy: microseconds a frame."""
    reference, sigma_rad = SingularValues(CHOSEN, FREE, SCALE), arcsets.angular_sigma(PINHOLE_RADIAL, TRUTH, field)
    frames = [Frame(field, k, sigma_rad) for k in range(field.n_frames)]
    prior, z, posterior, P = np.eye(6), np.zeros(6), np.empty((6, 6)), np.empty((6, 6))
    compiled_rays = [frame.directions(TRUTH) for frame in frames]
    plain_rays = [
        PINHOLE_RADIAL.directions_and_jacobian(TRUTH, frame.row_px, frame.col_px, PITCH) for frame in frames[::10]
    ]

    def compiled():
        for frame, at in zip(frames, compiled_rays, strict=True):
            reference.weigh(frame.star_start, frame.s_i, frame.sigma_rad)
            e, H = reference.rows(*at)
            kernels.information_update(prior, z, z, e, H, np.empty(6), posterior, P)

    def by_numpy():
        for frame, at in zip(frames[::10], plain_rays, strict=True):
            plain_update(frame, *at, z, prior)

    return best(compiled, repeats) / len(frames) * 1e6, best(by_numpy, repeats) / len(plain_rays) * 1e6


def best(run, repeats):
    """Shortest time of several runs, seconds."""
    run()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return min(times)


def measured(field, repeats):
    """Microseconds a frame of every form."""
    found = {}
    for name, run in FORMS.items():
        part = field.frames(0, field.n_frames // SLOW.get(name, 1))
        found[name] = best(lambda run=run, part=part: run(part), repeats) / part.n_frames * 1e6
    return found


def main(arguments=None):
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args(arguments)
    fields = {stars: star_field(np.random.default_rng(stars), options.frames, stars) for stars in PRINTED}
    found = {stars: measured(field, options.repeats) for stars, field in fields.items()}
    table = Table(title="microseconds a frame, one linearisation")
    for column in ("form", *(f"{stars} stars" for stars in PRINTED)):
        table.add_column(column, justify="left" if column == "form" else "right")
    for name in FORMS:
        table.add_row(name, *(f"{found[stars][name]:,.0f}" for stars in PRINTED))
    table.add_section()
    alone = [update_alone(field, options.repeats) for field in fields.values()]
    table.add_row("svd update alone, compiled", *(f"{compiled:,.0f}" for compiled, _ in alone))
    table.add_row("svd update alone, plain NumPy", *(f"{by_numpy:,.0f}" for _, by_numpy in alone))
    table.add_row("plain NumPy / compiled", *(f"{by_numpy / compiled:.0f}" for compiled, by_numpy in alone))
    table.add_section()
    for title, over, under in (
        ("angular / svd, both as printed", "angular, as printed", "svd, as printed"),
        ("angular gain / svd gain", "angular, gain form", "svd, gain form"),
        ("angular gain / svd information", "angular, gain form", "svd, information form"),
        ("angular / svd, both information", "angular, information form", "svd, information form"),
        ("arcs / svd information", "arcs", "svd, information form"),
        ("the whole filter: plain NumPy / compiled", "svd, plain NumPy", "svd, information form"),
    ):
        table.add_row(title, *(f"{found[stars][over] / found[stars][under]:.2f}" for stars in PRINTED))
    table.add_row("W Table 4: angular / svd", *(f"{ratio:.1f}" for ratio in PRINTED.values()))
    Console().print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
