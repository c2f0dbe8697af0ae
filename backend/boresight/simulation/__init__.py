"""Telemetry with known truth: the ST-16 sensors, their orbits and motions, and what their detectors would report."""

from __future__ import annotations
