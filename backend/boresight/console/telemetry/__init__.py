"""Telemetry sets: uploads, their tables and quality reports."""
