"""A catalogue deep enough for nearby stars."""

import pytest

from boresight.sky.catalogue import load_catalogue


@pytest.fixture(scope="session")
def deep_catalogue():
    return load_catalogue(None, magnitude_limit=12.0)
