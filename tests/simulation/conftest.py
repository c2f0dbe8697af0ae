"""The star catalogue, loaded once for all simulation tests."""

import pytest

from boresight.sky.catalogue import Catalogue, load_catalogue


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory) -> Catalogue:
    return load_catalogue(tmp_path_factory.mktemp("catalogue"))
