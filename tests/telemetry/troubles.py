"""Telemetry with one trouble each, and the finding that should name it."""

import numpy as np

from boresight.telemetry.schema import Telemetry

EXPOSURES, STARS = 30, 12
ROWS = EXPOSURES * STARS
MAGNITUDES = 3.0 + (np.arange(1, 500) % 30) / 10.0


class Stars:
    magnitude = MAGNITUDES

    def find_index(self, hip):
        return np.where((hip >= 1) & (hip < 500), hip - 1, -1)


def with_rows(values, changes):
    changed = values.copy()
    for row, value in changes.items():
        changed[row] = value
    return changed


def calm_telemetry():
    rng = np.random.default_rng(5)
    star_id = np.concatenate([rng.permutation(np.arange(1, 500))[:STARS] for _ in range(EXPOSURES)])
    frame = np.repeat(np.arange(EXPOSURES), STARS)
    # one star in each of twelve boxes, so that none comes close to another
    row = np.tile(np.repeat(np.arange(3), 4), EXPOSURES) * 256 + rng.uniform(5, 250, ROWS)
    col = np.tile(np.tile(np.arange(4), 3), EXPOSURES) * 256 + rng.uniform(5, 250, ROWS)
    return Telemetry(
        frame=frame,
        exposure=np.zeros(ROWS, dtype=np.int64),
        row_px=with_rows(row, {0: 0.0, 11: 766.0}),
        col_px=with_rows(col, {0: 0.0, 11: 1022.0}),
        time_utc=np.datetime64("2024-01-01", "us") + frame * 1_000_000,
        magnitude=MAGNITUDES[star_id - 1] + rng.normal(size=ROWS) * 0.1,
        star_id=star_id,
        velocity_m_s=np.full((ROWS, 3), 4000.0),
        temperature_c=np.full(ROWS, 20.0),
    )


def codes(report):
    return [finding["code"] for finding in report["findings"]]


def finding(report, code):
    return next(found for found in report["findings"] if found["code"] == code)
