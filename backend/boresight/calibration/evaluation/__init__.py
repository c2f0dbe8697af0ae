"""What a calibration is worth: scores on a validation set, comparisons, forecasts, alignment."""
