"""C_SD is updated only by a turn that was found against the set that is replaced."""

import json

import pytest

from boresight.uplink.parameter_files import alignment_json
from tests.uplink.packages import set_of

FOUND = {"sentence": "Loading these parameters turns the reported attitude by 4.1 arcsec.", "c_sd_update": [[1.0]]}


@pytest.fixture
def aligned():
    def make(started_from):
        subject = set_of("inverted_wang", 2, 1e-6, run={"started_from": started_from})
        subject["document"]["alignment"] = FOUND
        return subject

    return make


def test_a_turn_against_the_replaced_set_is_given(aligned):
    before = set_of("inverted_wang", 1)
    document = json.loads(alignment_json(aligned(before["document"]["parameters"]), before))
    assert document["alignment"] == FOUND
    assert document["use"].startswith("C_SD_new = C_SD_old c_sd_update")


def test_a_turn_against_other_parameters_is_withheld_with_the_reason(aligned):
    before = set_of("inverted_wang", 1, 5e-6)
    document = json.loads(alignment_json(aligned(set_of("inverted_wang", 0)["document"]["parameters"]), before))
    assert document["alignment"] is None
    assert "not those of PS-FM1-1" in document["sentence"]


def test_a_set_whose_attitudes_were_not_compared_says_so():
    document = json.loads(alignment_json(set_of("inverted_wang", 2), set_of("inverted_wang", 1)))
    assert document["sentence"].startswith("No attitude was compared")
