"""Tables of a calibration as pages, reports and terminals print them."""
