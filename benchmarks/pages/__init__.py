"""The pages of the documentation that are written by programs: benchmarks, capacity and figures."""
