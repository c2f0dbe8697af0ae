"""Sequential estimators: one a file, one line in the registry below. All take the same problem and give the same history."""

from __future__ import annotations

from collections.abc import Callable

from boresight.estimation.filters.angular import angular_filter
from boresight.estimation.filters.extended import extended_filter
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning
from boresight.estimation.filters.singular import singular_filter
from boresight.estimation.filters.square_root import square_root_filter
from boresight.estimation.filters.unscented import unscented_filter

Filter = Callable[..., FilterHistory]

FILTERS: dict[str, Filter] = {
    "sqrf": square_root_filter,
    "ekf": extended_filter,
    "ukf": unscented_filter,
    "svd": singular_filter,
    "angular": angular_filter,
}

__all__ = ["FILTERS", "Filter", "FilterHistory", "FilterState", "Tuning"]
