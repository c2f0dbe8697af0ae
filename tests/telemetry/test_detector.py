"""Telemetry that does not fit its sensor is refused with rows and columns."""

from __future__ import annotations

import pytest

from boresight.errors import RefusedInputError
from boresight.telemetry.detector import check_against_sensor

HEADER = "frame,exposure,row_px,col_px,star_id\n"


def test_matched_stars_off_the_detector_are_refused_with_row_and_column(read, sensor):
    telemetry = read(f"{HEADER}0,0,10,20,1\n0,0,769.6,20,2\n0,0,5,-2.51,3\n")
    with pytest.raises(RefusedInputError) as caught:
        check_against_sensor(telemetry, sensor)

    assert [(fault.row, fault.column) for fault in caught.value.faults] == [(3, "row_px"), (4, "col_px")]
    assert "769.6 is off the detector (-0.5 to 767.5): choose the right sensor" in str(caught.value)


def test_the_edge_of_the_outermost_pixels_is_on_the_detector(read, sensor):
    check_against_sensor(read(f"{HEADER}0,0,-0.5,-0.5,1\n0,0,767.5,1023.5,2\n"), sensor)


def test_the_centroid_of_a_star_cut_by_the_edge_is_let_pass(read, sensor):
    check_against_sensor(read(f"{HEADER}0,0,769.4,-2.4,1\n"), sensor)


def test_unmatched_detections_off_the_detector_are_let_pass(read, sensor):
    check_against_sensor(read(f"{HEADER}0,0,10,20,1\n0,0,9000,20,\n"), sensor)


def test_without_numbers_given_directions_count_as_matches(read, sensor):
    telemetry = read("frame,exposure,row_px,col_px,ra_deg,dec_deg\n0,0,9000,20,1,2\n0,0,9001,20,,\n")
    with pytest.raises(RefusedInputError) as caught:
        check_against_sensor(telemetry, sensor)

    assert [fault.row for fault in caught.value.faults] == [2]
