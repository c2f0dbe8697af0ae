"""New telemetry, taken in, calibrated and judged by a sensor's policy; what it finds is asked of people and never decided."""
