"""Enright, Jovanovic and Vaz 2018 made again: every table and figure of section III beside its printed numbers."""

from __future__ import annotations

from boresight.papers.enright.study import StudySize, run, write

__all__ = ["StudySize", "run", "write"]
