"""W Figures 3, 4, 6 and 8 as curves, judged by the conclusions that their text draws; `figures.wu_*` draws them.

All show the first set of group 2 at 0.2 px. Figures 3 and 4: the smallest singular value of H W of single frames at the truth.
Figure 6: both criteria along the run. Figure 8, the paper's field experiment: the six parameters along the run, here simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.papers.documents import Conclusion, judge
from boresight.papers.wu.estimators import Record
from boresight.papers.wu.pooled import Pooled
from boresight.papers.wu.tables import NO_Q
from boresight.simulation.sensors import WU_TRUTH

Drawing = dict[str, Any]

FIELD = ("no field data", "the night-sky images are not public; the run is simulated")
ORDER = ("f", "k2", "k1", "u0", "v0", "s")
#: Factor by which two courses may differ and still be called similar.
SIMILAR = 2.0
DRAWN_ONLY = (
    "unstated setting",
    "which stars make up the combinations of Models 1 to 3, and in what order, is drawn and not said",
)
LABELS = {
    ("svd-4-23", "full"): "SVD, full R",
    ("angular", "full"): "AD, full R",
    ("svd-4-23", "diagonal"): "SVD, diagonal R",
    ("angular", "diagonal"): "AD, diagonal R",
}


def drawings(pooled: Pooled) -> list[Drawing]:
    """Return every figure with its verdict."""
    seen = pooled.of("truth")[0]["observability"]
    return [_figure_3(seen), _figure_4(seen), *_figures_6(pooled), _figure_8(pooled)]


def _drawing(number: str, title: str, claim: str, conclusion: Conclusion, curves: Sequence[Drawing]) -> Drawing:
    row = judge(number, (), conclusion)
    return {
        "number": number,
        "title": title,
        "claim": claim,
        "verdict": row.verdict,
        "reason": row.reason,
        "curves": list(curves),
    }


def _observed(seen: Record, key: str, labels: Sequence[str]) -> list[Drawing]:
    return [
        {"label": label, "frame": seen["frame"], "minimum_singular_value": values}
        for label, values in zip(labels, seen[key], strict=True)
    ]


def _figure_3(seen: Record) -> Drawing:
    curves = _observed(seen, "models", [f"Model {model}" for model in (1, 2, 3, 4)])
    values = _numbers(seen["models"])
    largest = np.bincount(np.argmax(values, axis=0), minlength=4) / values.shape[1]
    said = ", ".join(f"Model {model} in {100 * share:.0f} %" for model, share in enumerate(largest, 1))
    return _drawing(
        "3", "Observability analysis of the models", "Model 4 has the largest minimum singular value in most frames.",
        Conclusion(bool(largest[3] > 0.5), f"largest: {said} of the frames.", *DRAWN_ONLY), curves,
    )  # fmt: skip


def _figure_4(seen: Record) -> Drawing:
    curves = _observed(seen, "values", ["σ1", "σ2", "σ3"])
    values = _numbers(seen["values"])
    worst = float(np.mean((values[0] < values[1]) & (values[0] < values[2])))
    return _drawing(
        "4", "Observability analysis of the three singular values", "σ1 alone is observed worse than σ2 and σ3.",
        Conclusion(worst > 0.5, f"σ1 is the least in {100 * worst:.0f} % of the frames.", *NO_Q), curves,
    )  # fmt: skip


def _numbers(columns: Sequence[Sequence[float | None]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Curves as rows, none as zero, without the frames that no curve has."""
    values = np.array([[one or 0.0 for one in column] for column in columns])
    return np.asarray(values[:, values.any(axis=0)])


def _figures_6(pooled: Pooled) -> list[Drawing]:
    courses = {place: pooled.of(*place)[0]["course"] for place in LABELS}
    svd, angular = (np.array(courses[key, "full"]["A"]) for key in ("svd-4-23", "angular"))
    ratio = svd / angular
    ended = {place: course["B"][-1] for place, course in courses.items()}
    apart = max(ended.values()) / min(ended.values()) - 1
    similar = Conclusion(
        bool(ratio.max() <= SIMILAR and ratio.min() >= 1 / SIMILAR),
        f"with the full R criterion A of SVD is {ratio.min():.2f} to {ratio.max():.2f} times that of AD along the run.",
        *NO_Q,
    )
    same = Conclusion(apart <= 0.01, f"the ends of criterion B differ by {100 * apart:.2f} %.", *NO_Q)
    curves = {
        which: [
            {"label": LABELS[place], "frame": course["frame"], "criterion_arcsec": course[which]}
            for place, course in courses.items()
        ]
        for which in "AB"
    }
    return [
        _drawing("6a", "Residual errors by criterion A, group 2", "Both methods converge at similar rates.", similar, curves["A"]),
        _drawing("6b", "Residual errors by criterion B, group 2", "Both methods end at the same residual.", same, curves["B"]),
    ]  # fmt: skip


def _figure_8(pooled: Pooled) -> Drawing:
    course = pooled.of("svd-4-23")[0]["course"]
    states, sigmas = np.array(course["states"]), np.array(course["sigmas"], dtype=np.float64)
    curves = [
        {
            "label": symbol,
            "unit": unit,
            "truth": float(truth),
            "frame": course["frame"],
            "value": states[:, p].tolist(),
            "three_sigma": (3 * sigmas[:, p]).tolist(),
        }
        for p, (symbol, unit, truth) in enumerate(
            zip(PINHOLE_RADIAL.symbols, PINHOLE_RADIAL.units, WU_TRUTH, strict=True)
        )
    ]
    settled = dict(zip(PINHOLE_RADIAL.symbols, course["settled"], strict=True))
    ours = sorted(settled, key=lambda symbol: settled[symbol])
    said = ", ".join(f"{symbol} {settled[symbol]}" for symbol in ours)
    return _drawing(
        "8", "Estimation results of the parameters", f"They converge in the order {', '.join(ORDER)} (printed: u0 twice).",
        Conclusion(tuple(ours) == ORDER, f"each stays within three of Table 1's precisions from frame: {said}.", *FIELD), curves,
    )  # fmt: skip
