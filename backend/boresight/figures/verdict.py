"""The one-line verdict of a report: as good as the worst of its answers, and never without the reason."""

from __future__ import annotations

from dataclasses import dataclass

from boresight.figures.chart import Result

UNSEEN_TYPICAL_SIGMAS = 1.0  # a direction known no better than the spread from unit to unit was not calibrated

FAILED = {
    "diverged": "The fit diverged: do not use these numbers.",
    "too_few_stars": "No exposure has enough stars: nothing was estimated.",
    "rank_deficient": "The data do not determine every free parameter: free fewer, or add frames with other stars.",
    "max_iterations": "The fit stopped before it came to rest: raise the number of iterations, or start closer.",
    "running": "The run is not over: everything below is provisional.",
}


@dataclass(frozen=True)
class Verdict:
    """A level of the console's status colours, its word, and why.

    Parameters
    ----------
    level
        `critical`, `serious`, `caution`, `normal` or `standby`.
    word
        In the heading.
    reasons
        Sentences.
    """

    level: str
    word: str
    reasons: tuple[str, ...]


def verdict(result: Result) -> Verdict:
    """Judge a result by its status, its statistics, its weakest direction and its validation."""
    status = str(result.get("status") or "unknown")
    if status != "converged":
        level = {"diverged": "critical", "too_few_stars": "critical", "running": "standby"}.get(status, "serious")
        return Verdict(level, status.replace("_", " "), (FAILED.get(status, f"The status is {status}."),))
    if worse := _worse_on_validation(result):
        return Verdict("serious", "converged, but no better", (worse, *_doubts(result)))
    if doubts := _doubts(result):
        return Verdict("caution", "converged, with reservations", doubts)
    return Verdict("normal", "converged and consistent", ("The statistics agree with the noise that was assumed.",))


def _worse_on_validation(result: Result) -> str:
    rms = (result.get("validation") or {}).get("rms_arc_rad") or {}
    before, after = rms.get("initial"), rms.get("final")
    if before is None or after is None or after < before:
        return ""
    return f"On the validation set the error went from {before * 1e6:.1f} to {after * 1e6:.1f} µrad."


def _doubts(result: Result) -> tuple[str, ...]:
    """Say what keeps a converged run from being trusted outright."""
    doubts = []
    if (result.get("chi2") or {}).get("consistent") is False:
        doubts.append(f"χ² per degree of freedom is {result['chi2_per_dof']:.3g}: the noise is not what was assumed.")
    if (result.get("nis") or {}).get("consistent") is False and result.get("method") != "batch":
        doubts.append("The innovations are outside their 95 % bounds: the sigmas of this filter are not honest.")
    seen = result.get("observability") or {}
    spread = [sigma for sigma in seen.get("sigma_of_direction") or () if sigma is not None]
    unknown = len(spread) < len(seen.get("singular_values") or ())
    if unknown or max(spread, default=0.0) > UNSEEN_TYPICAL_SIGMAS:
        doubts.append(str((seen.get("weakest") or {}).get("sentence") or "One direction was not seen at all."))
    return tuple(doubts)
