"""Alignments of two trackers from two of their runs: queued, computed by a server in the background, and kept for comparison."""
