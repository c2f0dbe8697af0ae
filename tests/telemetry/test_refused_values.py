"""A value that cannot be is refused with its row, its column and what to do."""

import numpy as np
import pytest

from tests.telemetry.files import GOOD, HEADER, ROWS, assert_single_fault, refused, with_columns


@pytest.mark.parametrize("column", ["frame", "exposure", "row_px", "col_px"])
def test_a_missing_column_is_named_with_those_the_file_has(read, column):
    error = refused(read, GOOD.replace(column, "other"))
    assert_single_fault(error, None, column, "missing", "other", "star_id")


@pytest.mark.parametrize("column", ["frame", "exposure", "row_px", "col_px"])
def test_an_empty_cell_in_a_required_column_is_refused(read, column):
    place = HEADER.split(",").index(column)
    cells = ROWS[1].split(",")
    cells[place] = ""
    error = refused(read, "\n".join([HEADER, ROWS[0], ",".join(cells)]))
    assert_single_fault(error, 3, column, "empty")


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ("abc", "'abc' is not a number"),
        ("nan", "not a measurement"),
        ("-Infinity", "not a measurement"),
        ("1e999", "inf"),
    ],
)
def test_text_nan_and_infinity_in_numbers_are_refused_with_row_and_column(read, cell, words):
    error = refused(read, GOOD.replace("30.5", cell))
    assert_single_fault(error, 3, "row_px", words)


@pytest.mark.parametrize(("column", "cell"), [("magnitude", "nan"), ("temperature_c", "inf"), ("sigma_px", "1,5")])
def test_optional_numbers_are_held_to_the_same(read, column, cell):
    error = refused(read, with_columns(column, f'"{cell}"'))
    assert_single_fault(error, 2, column, "empty")


@pytest.mark.parametrize("cell", ["1.5", "1e30", "99999999999999999999"])
def test_frames_exposures_and_star_numbers_are_whole_numbers(read, cell):
    error = refused(read, f"{HEADER}\n{cell},0,1,2,3\n0,{cell},1,2,3\n0,0,1,2,{cell}\n")
    assert [(fault.row, fault.column) for fault in error.faults] == [(2, "frame"), (3, "exposure"), (4, "star_id")]
    assert "whole number" in str(error)
    assert str(error).endswith("(and 2 more faults)")


def test_star_numbers_below_minus_one_are_refused(read):
    assert_single_fault(refused(read, GOOD.replace("-1", "-7")), 5, "star_id", "-7", "leave it empty")


def test_frames_out_of_order_are_refused(read):
    error = refused(read, "\n".join([HEADER, ROWS[3], *ROWS[:3]]))
    assert_single_fault(error, 3, "frame", "frame 0 follows frame 1", "sort")


def test_a_torn_exposure_is_refused(read):
    error = refused(read, "\n".join([HEADER, ROWS[0], ROWS[2], ROWS[1]]))
    assert_single_fault(error, 4, "exposure", "interrupted", "sort")


def test_a_star_twice_in_an_exposure_is_refused_with_both_rows(read):
    error = refused(read, GOOD.replace("40.25,", "40.25,11"))
    assert_single_fault(error, 3, "star_id", "star 11 is already in row 2", "leave star_id empty")


def test_unmatched_rows_are_no_duplicates_of_one_another(read):
    assert len(read(GOOD.replace(",11", ",0"))) == 4


def test_a_centroid_twice_in_an_exposure_is_refused_with_both_rows(read):
    error = refused(read, GOOD.replace("30.5,40.25", "10.5,20.25"))
    assert_single_fault(error, 3, "row_px", "row 2", "delete one")


@pytest.mark.parametrize(
    ("columns", "cells", "column", "words"),
    [
        ("ra_deg,dec_deg", "361,0", "ra_deg", "361"),
        ("ra_deg,dec_deg", "-181,0", "ra_deg", "-181"),
        ("ra_deg,dec_deg", "10,90.5", "dec_deg", "90.5"),
        ("ra_deg,dec_deg", "10,", "ra_deg", "give all of ra_deg and dec_deg"),
        ("q_x,q_y,q_z,q_w", "1,0,0,0.5", "q_x", "1.11803"),
        ("q_x,q_y,q_z,q_w", "1,0,0,", "q_x", "give all"),
        ("vx_km_s,vy_km_s,vz_km_s", "7500,0,0", "vx_km_s", "not metres"),
        ("vx_km_s,vy_km_s,vz_km_s", ",0,0", "vx_km_s", "give all"),
        ("sigma_px", "-0.1", "sigma_px", "not positive"),
        ("sigma_px", "0", "sigma_px", "not positive"),
        ("time_utc", "29/07/2019", "time_utc", "ISO 8601"),
        ("time_utc", "2019-02-30T00:00:00Z", "time_utc", "ISO 8601"),
        ("time_utc", "1800-01-01T00:00:00Z", "time_utc", "1900 and 2100"),
    ],
)
def test_values_that_cannot_be_are_refused(read, columns, cells, column, words):
    assert_single_fault(refused(read, with_columns(columns, cells)), 2, column, words)


@pytest.mark.parametrize(
    ("given", "missing"), [("ra_deg", "dec_deg"), ("q_x,q_y,q_z", "q_w"), ("vx_km_s,vz_km_s", "vy_km_s")]
)
def test_columns_that_only_make_sense_together_are_asked_for_together(read, given, missing):
    error = refused(read, with_columns(given, ",".join("0" for _ in given.split(","))))
    assert_single_fault(error, None, missing, "give all of")


def test_an_empty_row_of_a_group_is_absent(read):
    telemetry = read("frame,exposure,row_px,col_px,ra_deg,dec_deg\n0,0,1,2,,\n0,0,3,4,5,6\n")
    assert np.isnan(telemetry.ra_rad).tolist() == [True, False]
