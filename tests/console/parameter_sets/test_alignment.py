"""The rotation that a set brings along is part of the set, and of its hash."""

import pytest

from boresight.console.parameter_sets import service as parameter_sets
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import open_writing

ALIGNMENT = {
    "quaternion": [0.0, 1e-5, 0.0, 1.0],
    "rotation_arcsec": [0.0, 4.1, 0.0],
    "sigma_arcsec": [0.4, 0.4, None],
    "sigma_of_mean_arcsec": [0.1, 0.1, 0.2],
    "frames": 10,
    "scatter_arcsec": 1.0,
    "noise_arcsec": 2.0,
    "consistent": True,
    "sentence": "Loading these parameters turns the reported attitude by 4.1 ± 0.1 arcsec.",
    "c_sd_update": [[1.0, 0.0, -2e-5], [0.0, 1.0, 0.0], [2e-5, 0.0, 1.0]],
}


@pytest.fixture
def set_with(engine, blobs, people, finished_run):
    def make(**result):
        with open_writing(engine) as session:
            run = finished_run(session, people["ana"].user_id, **result)
            return parameter_sets.create_from_run(session, people["ana"], blobs, run.id)

    return make


def test_a_set_carries_the_alignment_of_its_run(set_with):
    row = set_with(alignment=ALIGNMENT)
    assert row.document["alignment"] == ALIGNMENT
    assert row.sha256 == compute_sha256(row.document)


def test_another_alignment_is_another_set(set_with):
    document = set_with(alignment=ALIGNMENT).document
    assert compute_sha256(document) != compute_sha256(document | {"alignment": ALIGNMENT | {"frames": 11}})


def test_a_result_from_before_alignments_were_found_makes_a_set_without_one(set_with):
    assert set_with().document["alignment"] is None
