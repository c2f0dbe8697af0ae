"""Several telemetry sets of one sensor calibrated as one: its passes, and what each of them says by itself."""
