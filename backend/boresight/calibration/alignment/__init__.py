"""Alignment of two frames on one body: attitudes of trackers and references, the rotation between them, and its result."""
