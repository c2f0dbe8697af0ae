"""Calibration runs: launching, following, reading and comparing them."""
