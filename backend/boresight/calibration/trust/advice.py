"""What the trust numbers ask a person to do: the sentences worth telling, the likeliest cause first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from boresight.arrays import BoolArray
from boresight.calibration.advice_kinds import CAUSE, Advice
from boresight.calibration.calibration import Cause, Coverage, Trust
from boresight.calibration.trust.residuals import OTHER_PARITY

#: The claimed sigmas over the bound below which they are too small to be honest.
TOO_SMALL = 0.97
#: So many spare parameters mean a set too small for the model rather than a lucky start.
SEVERAL = 2
#: Parts of the detector, rows and columns of them, and the share that has stars below which the rest is spoken of.
PARTS, COVERED = (6, 8), 0.7
#: Likelihoods below which a cause is only a guess, and from which on it is told as a fact.
EVEN_ODDS, CERTAIN = 0.5, 0.995
#: Causes of which the stars' own sentence says more, for it names them.
OF_STARS = ("places", "identities")
#: Causes of which the residual spline says more, for it names the camera model that takes them up.
OF_THE_LENS = ("tangential", "radial", "affine", "lens")


def cause_advice(trust: Trust, causes: Sequence[Cause]) -> list[Advice]:
    """Say what explains the tests that noticed something; it comes before all other advice."""
    return [*_advise_on_geometry(trust), *_advise_on_causes(trust, causes)]


def trust_advice(trust: Trust, coverage: Coverage | None = None) -> list[Advice]:
    """Collect what else in the trust calls for something; `coverage`: where on the detector the stars were."""
    return [*_advise_on_coverage(trust, coverage), *_advise_on_estimate(trust), *_advise_on_spare_parameters(trust)]


def _advise_on_geometry(trust: Trust) -> Iterator[Advice]:
    """A mirrored detector is graver than anything else."""
    sentence = trust.unavailable.get("residuals", "")
    if sentence in OTHER_PARITY.values():
        yield Advice(sentence, "parity")


def _advise_on_causes(trust: Trust, causes: Sequence[Cause]) -> Iterator[Advice]:
    """What explains the tests that noticed something, the likeliest first."""
    for place, cause in enumerate(causes):
        opening = "Also: " if place else _opening(cause.likelihood)
        yield Advice(f"{opening}{cause.sentence} {cause.remedy}", f"{CAUSE}{cause.name}")
        if cause.name in OF_THE_LENS and trust.residual_spline is not None and trust.residual_spline.structure:
            yield Advice(trust.residual_spline.sentence, "residual_spline")
        if cause.name in OF_STARS and trust.suspects and trust.stars_sentence is not None:
            yield Advice(trust.stars_sentence, "stars")


def _opening(likelihood: float) -> str:
    """How surely the first cause is one: at less than even odds nothing is called likely."""
    if likelihood < EVEN_ODDS:
        return f"No cause explains the test results well; possible cause ({likelihood:.0%}): "
    return f"Most likely cause ({likelihood:.0%}): " if likelihood < CERTAIN else ""


def _advise_on_coverage(trust: Trust, coverage: Coverage | None) -> Iterator[Advice]:
    """Say how much of the detector held no star, and how far off arcs may be there if the camera model holds."""
    if coverage is None:
        return
    counts = np.array(coverage.counts)
    parts = (
        counts.reshape(PARTS[0], counts.shape[0] // PARTS[0], PARTS[1], counts.shape[1] // PARTS[1]).sum(axis=(1, 3))
        > 0
    )
    if parts.mean() >= COVERED:
        return
    yield Advice(
        f"Stars cover {int(parts.sum())} of {parts.size} regions of the detector; elsewhere the camera is extrapolated"
        f"{_predicted(trust, coverage, parts)}: add frames with stars in the other regions, or use only the part that is covered.",
        "coverage",
    )


def _predicted(trust: Trust, coverage: Coverage, parts: BoolArray) -> str:
    """The error of arcs in the parts without stars, and in the others."""
    seen = trust.arc_sigma_map
    if seen is None:
        return ""
    rows, columns = np.array(coverage.row_edges_px, float), np.array(coverage.col_edges_px, float)
    i, j = (
        np.clip((np.array(at, float) - edges[0]) / (edges[-1] - edges[0]) * n, 0, n - 1).astype(int)
        for at, edges, n in ((seen.row_px, rows, PARTS[0]), (seen.col_px, columns, PARTS[1]))
    )
    sigma = np.array(seen.sigma_arcsec, float)
    inside = parts[np.ix_(i, j)]
    if not inside.any() or inside.all() or not np.isfinite(sigma).all():
        return ""
    return (
        f", where an arc of {seen.arc_deg:.2g}° may be off by {sigma[~inside].max():.2g} arcsec (1 sigma, if the camera model is "
        f"valid there), compared with at most {sigma[inside].max():.2g} arcsec where there are stars"
    )


def _advise_on_estimate(trust: Trust) -> Iterator[Advice]:
    """Sigmas below the bound."""
    efficiency = trust.efficiency
    if efficiency is not None and efficiency.overall_ratio < TOO_SMALL:
        yield Advice(efficiency.sentence, "efficiency")


def _advise_on_spare_parameters(trust: Trust) -> Iterator[Advice]:
    """Parameters the data do not ask for; one alone may have started near its truth by luck."""
    if sum(not entry.needed for entry in trust.drop_one or ()) >= SEVERAL and trust.drop_one_sentence is not None:
        yield Advice(trust.drop_one_sentence, "drop_one")
