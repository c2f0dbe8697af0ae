"""What a run would be, before it is queued: its size, its time, what it will know, and what to beware of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boresight.services.forecasts import Sight
from boresight.services.orders import Order
from boresight.services.run_estimates import pace_of, pairs_of, predicted_s
from boresight.store.sessions import Session
from boresight.telemetry.sensors import parse_sensor


def dry_run(session: Session, order: Order, sight: Sight | None = None) -> dict[str, Any]:
    """Say what a run would be.

    Parameters
    ----------
    sight
        Lets it look at the stars, for `forecast`; without one that is None.

    Returns
    -------
    `sensor`, `telemetry_set`, `validation_set`, `settings`, `frames`, `exposures`, `stars`, `pairs`, `free`; `predicted_s` with
    `predicted_range_s`, between which four of five past runs' paces lie, and `paced_by`, how many these were; `forecast`, see
    `calibration.forecast`; `warnings`, sentences.
    """
    telemetry, settings = order.telemetry, order.settings
    free = list(settings.free or parse_sensor(order.sensor.document).free)
    quality = telemetry.quality
    exposures = quality.get("usable_exposures", telemetry.frames)
    pairs = pairs_of(quality.get("usable", telemetry.stars), exposures)
    pace = pace_of(session, settings.method)
    seconds = [
        round(predicted_s(settings.document(), telemetry.frames, telemetry.stars, one), 3)
        for one in (pace.s_per_star, pace.low, pace.high)
    ]
    forecast = None
    if sight is not None:
        forecast = sight.forecast(telemetry.table_sha256, order.sensor.document, settings)
    return {
        "sensor": order.sensor.name,
        "telemetry_set": telemetry.name,
        "validation_set": None if order.validation is None else order.validation.name,
        "settings": settings.document(),
        "frames": telemetry.frames,
        "exposures": exposures,
        "stars": telemetry.stars,
        "pairs": pairs,
        "free": free,
        "predicted_s": seconds[0],
        "predicted_range_s": seconds[1:],
        "paced_by": pace.runs,
        "forecast": forecast,
        "warnings": _warnings(order, free, pairs),
    }


def expected_s(session: Session, orders: Sequence[Order]) -> float:
    """Return how long runs of one method will take together, seconds of computing."""
    if not orders:
        return 0.0
    pace = pace_of(session, orders[0].settings.method).s_per_star
    settings = orders[0].settings.document()
    return round(sum(predicted_s(settings, order.telemetry.frames, order.telemetry.stars, pace) for order in orders), 3)


def _warnings(order: Order, free: Sequence[str], pairs: int) -> list[str]:
    """Gather what an analyst should know before queueing."""
    warnings = [str(sentence) for sentence in order.telemetry.quality.get("warnings") or ()]
    if pairs < 10 * len(free):
        warnings.append(f"About {pairs} arcs for {len(free)} parameters is little; free fewer or use a longer set.")
    if order.validation is None:
        warnings.append("Without a validation set nothing independent will say whether the result is better.")
    return warnings
