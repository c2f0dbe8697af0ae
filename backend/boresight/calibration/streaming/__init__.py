"""Calibrating a set larger than memory: a working copy of it in pieces, and the same estimators over them.

=====================  ================================================================================================
`columns`              arrays in one file, mapped when asked for
`telemetry_pieces`     the set as it came, whole frames a piece
`stored_arcs`          the arcs of all pieces, in the place of an `ArcSet`
`stored_problem`       what is known of them
`ordering`             from telemetry to arcs, piece by piece
`streamed_set`         a set whose given matches stand
`matching`             matching ranges of frames under any state
`rematched_set`        a set whose matches follow the estimate
`sample`               the part of a set that is judged in memory
=====================  ================================================================================================

The scratch folder holds all state. Pieces go through a `Spread`, so that other machines can do them.
"""
