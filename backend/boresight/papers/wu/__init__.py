"""Wu et al. 2019 made again: Tables 2 to 4 and Figures 3, 4, 6 and 8 beside the printed numbers."""

from __future__ import annotations

from boresight.papers.wu.study import StudySize, run, write

__all__ = ["StudySize", "run", "write"]
