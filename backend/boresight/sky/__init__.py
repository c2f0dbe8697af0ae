"""The stars: catalogue, where the Earth carries the observer, and the directions in which stars are seen."""

from __future__ import annotations
