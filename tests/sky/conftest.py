"""A catalogue deep enough for nearby stars."""

from __future__ import annotations

import pytest

from boresight.sky.catalogue import load_catalogue


@pytest.fixture(scope="session")
def deep_catalogue():
    """Faint enough for Barnard's star (Hp 9.5) and Proxima (10.8)."""
    return load_catalogue(None, magnitude_limit=12.0)
