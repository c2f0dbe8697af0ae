"""Retention of telemetry: which files nothing needs any more, and their removal."""
