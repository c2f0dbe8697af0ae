"""One file a chart: a pure function from calibration JSON to a figure."""
