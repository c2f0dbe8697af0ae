"""Two calibrations with every member: figures are tested without running an estimator."""

import pytest

from tests.figures.examined import examined, sequential


@pytest.fixture(scope="session")
def sequential_result():
    return sequential()


@pytest.fixture(scope="session")
def batch_result():
    return examined("batch")
