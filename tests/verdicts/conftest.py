"""The star catalogue, loaded once."""

import pytest

from boresight.sky.catalogue import load_catalogue


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory):
    return load_catalogue(tmp_path_factory.mktemp("catalogue"))
