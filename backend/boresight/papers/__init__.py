"""Whole experiments: how fast the product is beside its peers, and, as they come, the papers' tables made again."""

from __future__ import annotations
