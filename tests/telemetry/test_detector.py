"""A few stars off the detector are left out and told; telemetry that does not fit its sensor is refused with rows and columns."""

import dataclasses

import numpy as np
import pytest

from boresight.errors import RefusedInputError
from boresight.telemetry.quality.detector import OffDetector, check_against_sensor
from boresight.telemetry.schema import select_rows
from tests.telemetry.troubles import calm_telemetry

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


def off_by(telemetry, count, px=5.0):
    rows = np.linspace(0, len(telemetry) - 1, count).round().astype(int)
    row_px = telemetry.row_px.copy()
    row_px[rows] = 767.5 + px
    return dataclasses.replace(telemetry, row_px=row_px), rows


def test_one_star_5_px_off_the_detector_is_left_out_with_its_row_and_distance(sensor):
    calm = calm_telemetry()
    moved, rows = off_by(calm, 1)
    off = check_against_sensor(moved, sensor).document()
    star = {"row": int(rows[0]) + 2, "frame": 0, "exposure": 0, "star_id": int(calm.star_id[0]), "off_px": 5.0}
    assert off == {"stars": 1, "farthest_px": 5.0, "rows": [star]}


@pytest.mark.parametrize("repeats", [1, 4], ids=["of a few", "of many"])
def test_a_set_is_refused_from_one_star_more_than_are_left_out(sensor, repeats):
    whole = calm_telemetry()
    whole = dataclasses.replace(
        whole,
        **{
            name: np.tile(values, (repeats,) + (1,) * (values.ndim - 1))
            for name, values in vars(whole).items()
            if isinstance(values, np.ndarray)
        },
    )
    most = max(3, len(whole) // 100)
    assert check_against_sensor(off_by(whole, most)[0], sensor).stars == most
    moved, rows = off_by(whole, most + 1)
    with pytest.raises(RefusedInputError) as caught:
        check_against_sensor(moved, sensor)
    assert [fault.row for fault in caught.value.faults] == (rows + 2).tolist()
    assert f"{most + 1} of its {len(whole):,} matched stars" in str(caught.value)


@pytest.mark.parametrize("count", [2, 60])
def test_what_is_left_out_or_refused_does_not_depend_on_the_parts_a_set_comes_in(sensor, count):
    moved, _ = off_by(calm_telemetry(), count)
    whole, parts = OffDetector(), OffDetector()
    whole.look_at(moved, sensor)
    for first in range(0, len(moved), 36):
        part = OffDetector()
        part.look_at(select_rows(moved, slice(first, first + 36)), sensor)
        parts.absorb(part)
    assert parts.document() == whole.document()
    assert parts.too_many == whole.too_many == (count == 60)
    if whole.too_many:
        said = []
        for off in (whole, parts):
            with pytest.raises(RefusedInputError) as caught:
                off.refuse()
            said.append((str(caught.value), caught.value.faults))
        assert said[0] == said[1]
