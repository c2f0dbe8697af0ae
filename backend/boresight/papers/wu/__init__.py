"""Wu et al. 2019 made again: Tables 2 to 4 and Figures 3, 4, 6 and 8 beside the printed numbers.

`printed` holds the paper's numbers, `estimators` what is run on each simulated set and how it is judged; `tables`, `drawings` and
`findings` say what came out, `timing` measures by the clock, and `study` runs all of it and writes it down.
"""

from __future__ import annotations

from boresight.papers.wu.study import Plan, run, write

__all__ = ["Plan", "run", "write"]
