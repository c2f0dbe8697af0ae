"""Wu et al. 2019 made again: Tables 2 to 4 and Figures 3, 4, 6 and 8 beside the printed numbers.

`printed` holds the paper's numbers, `estimators` what is run and with which R, `criteria` the paper's two criteria; `trials` runs
all on one simulated set, `study` runs the sets, `pooled` puts them together and `timing` measures by the clock; `tables`,
`drawings` and `findings` say what came out, and `document` and `report` write it down. `papers.documents` judges a row.
"""

from __future__ import annotations

from boresight.papers.wu.study import Plan, run, write

__all__ = ["Plan", "run", "write"]
