"""Enright, Jovanovic and Vaz 2018 made again: every table and figure of section III beside its printed numbers.

`printed` holds the paper's numbers, `estimators` what is run, `trials` runs it on one simulated set, `study` runs all of
them on both cores, `pooled` puts the sets together; `tables`, `drawings`, `findings`, `matching_findings` and `questions` say
what came out, `verdicts` holds the rule that judges a row, and `document` and `report` write it down.
"""

from __future__ import annotations

from boresight.papers.enright.study import Plan, run, write

__all__ = ["Plan", "run", "write"]
