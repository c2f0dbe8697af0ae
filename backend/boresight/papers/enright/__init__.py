"""Enright, Jovanovic and Vaz 2018 made again: every table and figure of section III beside its printed numbers.

`printed` holds the paper's numbers, `estimators` what is run on each simulated set, `pooled` puts the sets together; `tables`,
`drawings` and `findings` say what came out, and `study` runs all of it and writes it down. `papers.documents` judges a row.
"""

from __future__ import annotations

from boresight.papers.enright.study import Plan, run, write

__all__ = ["Plan", "run", "write"]
