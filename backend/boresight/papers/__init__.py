"""The tables and figures of two papers, made again on simulated sensors."""

from __future__ import annotations
