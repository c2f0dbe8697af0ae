"""From telemetry and a sensor to a calibration that says how far it can be trusted.

One function, `calibrate.calibrate`, is what the command line, the workers, the studies and notebooks all call.
"""

from __future__ import annotations
