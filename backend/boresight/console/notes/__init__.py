"""Notes on runs, sensors and parameter sets."""
