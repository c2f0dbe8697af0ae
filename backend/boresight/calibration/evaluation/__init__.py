"""What a calibration is worth: held-out scores, comparisons, forecasts, alignment."""
