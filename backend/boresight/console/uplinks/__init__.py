"""Uplink packages, tables on board, and what was recorded of them."""
