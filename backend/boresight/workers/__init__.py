"""The computation of runs: worker processes, and the dispatcher that keeps the rows of runs correct when processes die."""

from __future__ import annotations
