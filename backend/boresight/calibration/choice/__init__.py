"""The least camera model that a telemetry set asks for, chosen by evidence."""
