"""Matching a telemetry set with the catalogue, and what the flight software would accept of it."""
