"""Why a telemetry set does not match: a search over the mistakes that sensor files and telemetry have, verified by matching."""

from __future__ import annotations
