"""Importing: what other programs write, by a mapping profile, as telemetry."""
