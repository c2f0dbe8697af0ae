"""Where runs are computed: worker processes, and the loop that keeps the run rows true whatever dies."""

from __future__ import annotations
