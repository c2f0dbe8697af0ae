"""From images to telemetry: reading them, what is wrong with the detector's pixels, stars and their centroids."""

from __future__ import annotations
