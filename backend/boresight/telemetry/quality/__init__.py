"""The quality report of a telemetry set and the findings in it."""
