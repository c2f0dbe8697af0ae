"""Calibrating a set larger than memory: a working copy of it in pieces, and the same estimators over them.

=====================  ================================================================================================
`telemetry_pieces`     the set as it came, whole frames a piece
`ordering`             from telemetry to arcs, piece by piece
`matching`             matching ranges of frames under any state
`sample`               the part of a set that is judged in memory
=====================  ================================================================================================

The scratch folder holds all state. Pieces go through a `Spread`, so that other machines can do them.
"""

from __future__ import annotations
