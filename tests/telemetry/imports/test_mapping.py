"""Units, origins, conventions, numbering and order; and what is refused, by row and column of the file that came."""

import io

import numpy as np
import orjson
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_matrix
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.mapping import import_files
from boresight.telemetry.imports.profile import parse_profile
from boresight.telemetry.readers import read_telemetry
from tests.refusals import has_code
from tests.telemetry.imports.conftest import source

LONG = {"frames": {"column": "F"}, "row": {"column": "Y"}, "col": {"column": "X"}}
TEXT = "F,X,Y\n1,10,20\n1,11,21\n2,12,22\n"


def of(axis):
    return {**LONG, "row": {"column": "Y", **axis}}


@pytest.mark.parametrize(
    ("axis", "row_px"),
    [
        ({}, 20.0),
        ({"origin": 1}, 19.0),
        ({"origin": 0.5}, 19.5),
        ({"origin": 100, "reversed": True}, 80.0),
        ({"unit": "um", "origin": 2.0}, 18 / 4.0),
        ({"unit": "mm"}, 20 / 4e-3),
        ({"unit": "mm", "origin": "centre"}, 20 / 4e-3 + 49.5),
    ],
)
def test_a_coordinate_becomes_a_row_by_its_origin_unit_and_sense(load, axis, row_px):
    profile = {**of(axis), "detector": {"rows": 100, "columns": 200, "pixel_pitch_m": 4e-6}}
    assert load(TEXT, profile).telemetry.row_px[0] == pytest.approx(row_px)


def test_the_detector_of_a_sensor_comes_before_that_of_the_profile(load, sensor):
    profile = {**of({"origin": "centre"}), "detector": {"rows": 100, "columns": 200}}
    assert load(TEXT, profile, sensor=sensor).telemetry.row_px[0] == 20 + (768 - 1) / 2


@pytest.mark.parametrize("axis", [{"unit": "mm"}, {"origin": "centre"}])
def test_lengths_and_middles_want_a_detector(load, axis):
    with pytest.raises(RefusedInputError, match="sensor"):
        load(TEXT, of(axis))


def test_rows_are_put_in_order_and_keep_the_order_of_the_file_within_an_exposure(load):
    telemetry = load("F,X,Y\n2,12,22\n1,11,21\n2,1,2\n1,10,20\n", LONG).telemetry
    assert telemetry.frame.tolist() == [1, 1, 2, 2]
    assert telemetry.col_px.tolist() == [11, 10, 12, 1]


@pytest.mark.parametrize(
    ("text", "row", "column"),
    [
        ("F,X,Y\n1,10,20\n1,x,21\n", 3, "X"),
        ("F,X,Y\n1,10,20\n1,,21\n", 3, "X"),
        ("F,X,Y\n1,10,20\n,11,21\n", 3, "F"),
        ("F,X,Y\n1.5,10,20\n1,11,21\n", 2, "F"),
        ("F,X,Y\n2,10,20\n1,11,21\n2,10,20\n", 4, "Y"),  # the same centroid twice, after sorting
        ("F,X,Y\n2,10,20\n1,11,inf\n", 3, "Y"),
    ],
)
def test_a_fault_is_told_by_row_and_column_of_the_file(load, text, row, column):
    with pytest.raises(RefusedInputError) as refused:
        load(text, LONG)
    assert (refused.value.faults[0].row, refused.value.faults[0].column) == (row, column)


def test_a_repeated_centroid_names_the_row_of_the_file_that_it_repeats(load):
    with pytest.raises(RefusedInputError) as refused:
        load("F,X,Y\n2,10,20\n1,11,21\n2,10,20\n", LONG)
    assert "row 2" in refused.value.faults[0].detail


def test_a_fault_of_a_wide_table_names_the_column_of_its_star(load):
    profile = {"wide": {"count": 9}, "frames": {"by": "record"}, "row": {"column": "Y{n}"}, "col": {"column": "X{n}"}}
    with pytest.raises(RefusedInputError) as refused:
        load("X1,Y1,X2,Y2\n1,2,3,4\n1,2,,4\n", profile)
    assert (refused.value.faults[0].row, refused.value.faults[0].column) == (3, "X2")
    with pytest.raises(RefusedInputError) as refused:
        load("X1,Y1,X2,Y2\n1,2,3,4\n1,2,1,2\n", profile)
    assert (refused.value.faults[0].row, refused.value.faults[0].column) == (3, "Y2")


def test_a_wide_table_says_which_of_its_places_are_stars(load):
    profile = {
        "wide": {"first": 0, "count": 3, "count_column": "N"},
        "frames": {"column": "F"},
        "row": {"column": "Y{n}"},
        "col": {"column": "X{n}"},
    }
    telemetry = load("F,N,X0,Y0,X1,Y1,X2,Y2\n4,2,1,2,3,4,9,9\n5,0,9,9,9,9,9,9\n6,3,1,2,3,4,5,6\n", profile).telemetry
    assert telemetry.frame.tolist() == [4, 4, 6, 6, 6]
    assert telemetry.col_px.tolist() == [1, 3, 1, 3, 5]


def test_a_missing_column_is_named_with_the_one_that_may_be_meant(load):
    with pytest.raises(RefusedInputError, match="FRAM") as refused:
        load("FRAM,X,Y\n1,2,3\n", {**LONG, "frames": {"column": "FRAME"}})
    assert refused.value.faults[0].column == "FRAME"


def test_a_qualified_name_is_found_by_its_end_and_refused_where_two_end_so(load):
    text = "/a/F,/a/st/x,/a/st/Y\n1,10,20\n"
    assert load(text, LONG).telemetry.col_px[0] == 10
    with pytest.raises(RefusedInputError, match="2 columns"):
        load("F,/a/X,/b/X,Y\n1,2,3,4\n", LONG)


Q = {"columns": ["A", "B", "C", "D"]}


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
@pytest.mark.parametrize("sense", ["icrs_to_detector", "detector_to_icrs"])
@pytest.mark.parametrize("convention", ["hamilton", "jpl"])
def test_every_convention_of_a_quaternion_turns_the_same_star_onto_the_same_pixel(load, order, sense, convention):
    q = np.array([0.1, -0.2, 0.3, np.sqrt(1 - 0.14)])
    # JPL's direction cosines of q are the transpose of Hamilton's; the inverse rotation is the transpose too
    matrix = to_matrix(q)
    told = matrix if (convention == "hamilton") == (sense == "icrs_to_detector") else matrix.T
    cells = q if order == "xyzw" else np.roll(q, 1)
    text = "F,X,Y,A,B,C,D\n1,10,20," + ",".join(map(str, cells)) + "\n"
    telemetry = load(
        text, {**LONG, "quaternion": {**Q, "order": order, "sense": sense, "convention": convention}}
    ).telemetry
    np.testing.assert_allclose(to_matrix(telemetry.quaternion[0]), told, atol=1e-12)


def test_a_mounting_turns_what_the_body_sees_into_what_the_detector_sees(load):
    half = np.sqrt(0.5)
    text = f"F,X,Y,A,B,C,D\n1,10,20,{half},0,0,{half}\n"
    telemetry = load(text, {**LONG, "quaternion": {**Q, "mounting": [0, 0, half, half]}}).telemetry
    seen = to_matrix(telemetry.quaternion[0]) @ [0, 1, 0]  # by the body about x: to z; the mounting leaves z
    np.testing.assert_allclose(seen, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(to_matrix(telemetry.quaternion[0]) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_a_quaternion_that_is_no_rotation_is_refused_by_its_row(load):
    with pytest.raises(RefusedInputError) as refused:
        load("F,X,Y,A,B,C,D\n1,10,20,0,0,0,1\n1,11,20,1,1,0,1\n", {**LONG, "quaternion": Q})
    assert (refused.value.faults[0].row, refused.value.faults[0].column) == (3, "A")


PACKETS = """time_utc,row_px,col_px,q_x,q_y,q_z,q_w
2026-11-20T00:00:00Z,,,0,0,0,1
2026-11-20T00:00:01Z,10,20,,,,
2026-11-20T00:00:01Z,11,21,,,,
2026-11-20T00:00:04Z,,,0,0,1,0
2026-11-20T00:01:00Z,12,22,,,,
2026-11-20T00:02:00Z,,,0,0,0,1
"""


def test_packets_of_quaternions_give_exposures_between_them_an_attitude_and_others_none(load):
    made = load(PACKETS, "packets")
    q = made.telemetry.quaternion
    angle = np.pi * 0.25 / 2  # a quarter of the half turn
    np.testing.assert_allclose(q[0], [0, 0, np.sin(angle), np.cos(angle)], atol=1e-12)
    np.testing.assert_allclose(q[1], q[0])
    assert np.all(np.isnan(q[2]))  # two minutes between packets, ten seconds allowed
    assert any(note.startswith("1 of 3 stars") for note in made.notes)


def test_quaternions_may_be_in_a_table_of_their_own(load, tmp_path):
    stars = "T,X,Y\n2026-11-20T00:00:01Z,10,20\n"
    (tmp_path / "q.csv").write_text("T,A,B,C,D\n2026-11-20T00:00:00Z,0,0,0,1\n2026-11-20T00:00:02Z,0,0,1,0\n")
    profile = {
        "frames": {"by": "time"},
        "row": {"column": "Y"},
        "col": {"column": "X"},
        "time": {"column": "T"},
        "quaternion": Q,
    }
    made = load(stars, profile, attitude=tmp_path / "q.csv")
    np.testing.assert_allclose(made.telemetry.quaternion[0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    (tmp_path / "q.csv").write_text("T,A,B,C,D\n2026-11-21T00:00:00Z,0,0,0,1\n")
    with pytest.raises(RefusedInputError, check=has_code("times-do-not-overlap")):
        load(stars, profile, attitude=tmp_path / "q.csv")


def test_star_numbers_flux_temperature_and_filters(load):
    text = "F,X,Y,ID,FLUX,T,FLAGS,NOTE\n"
    text += "1,1,2,HIP 677,100,300,0,a\n1,2,3,-1,0,301,0,b\n1,3,4,TYC 1-2-3,1,302,0,c\n1,5,6,9,1,303,4,d\n"
    profile = {
        **LONG,
        "layout": {"where": {"FLAGS": ["0"]}},
        "star_id": {"column": "ID"},
        "magnitude": {"column": "FLUX", "kind": "flux", "zero_point": 20.0},
        "temperature": {"column": "T", "unit": "K"},
        "keep": ["NOTE"],
    }
    made = load(text, profile)
    assert made.telemetry.star_id.tolist() == [677, 0, 0]
    assert made.telemetry.magnitude[[0, 2]].tolist() == [15.0, 20.0]
    assert np.isnan(made.telemetry.magnitude[1])
    assert made.telemetry.temperature_c[0] == pytest.approx(26.85)
    assert made.telemetry.unknown["NOTE"].to_pylist() == ["a", "b", "c"]
    assert len(made.notes) == 2  # a flux of nothing, a star of another catalogue


def test_directions_in_hours_and_radians(load):
    text = f"F,X,Y,R,D\n1,1,2,12,{np.pi / 4}\n"
    profile = {**LONG, "directions": {"ra": "R", "ra_unit": "hour", "dec": "D", "dec_unit": "rad"}}
    telemetry = load(text, profile).telemetry
    assert np.degrees([telemetry.ra_rad[0], telemetry.dec_rad[0]]).tolist() == pytest.approx([180, 45])


def test_several_files_are_one_set(tmp_path):
    for name, text in (("a.csv", "X,Y\n1,2\n3,4\n"), ("b.csv", "X,Y\n5,6\n")):
        (tmp_path / name).write_text(text)
    profile = parse_profile(
        {"name": "images", "frames": {"by": "file"}, "row": {"column": "Y"}, "col": {"column": "X"}}
    )
    made = import_files([source(tmp_path / "a.csv"), source(tmp_path / "b.csv")], profile)
    assert made.telemetry.frame.tolist() == [0, 0, 1]
    assert len(made.record()["sources"]) == 2
    numbered = parse_profile({"name": "numbered", **LONG})
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(TEXT)
    with pytest.raises(RefusedInputError, match="twice"):
        import_files([source(tmp_path / "a.csv"), source(tmp_path / "b.csv")], numbered)


@pytest.mark.parametrize("suffix", [".csv", ".jsonl", ".parquet"])
def test_what_is_written_is_telemetry_and_says_the_same_each_time(load, tmp_path, suffix):
    made = load(TEXT, LONG)
    written = []
    for _ in range(2):
        stream = io.BytesIO()
        made.write(stream, suffix)
        written.append(stream.getvalue())
    assert written[0] == written[1]
    path = tmp_path / f"out{suffix}"
    path.write_bytes(written[0])
    assert read_telemetry(path).row_px.tolist() == made.telemetry.row_px.tolist()
    if suffix == ".parquet":
        record = orjson.loads(arrow_parquet.read_schema(path).metadata[b"boresight.import"])
        assert record == made.record()
        assert record["profile"]["sha256"] == made.profile.sha256


def test_the_preview_shows_what_stood_in_the_file_beside_what_it_means(load):
    made = load("F,X,Y\n" + "".join(f"{k // 3},{k},{2 * k}\n" for k in range(30)), of({"origin": 1}))
    assert len(made.preview) == 10
    second = made.preview[1]
    assert (second.row, second.source["Y"], second.telemetry["row_px"]) == (3, "2", 1.0)
    assert {meaning.column for meaning in made.meanings} >= {"frame", "exposure", "row_px", "col_px"}


def test_a_profile_says_no_more_than_it_must_and_its_hash_tells_what_it_says():
    profile = parse_profile({"name": "mine", **LONG})
    assert parse_profile(profile.to_dict()) == profile
    again = parse_profile({"name": "mine", "version": 7, **LONG, "layout": {"format": "auto"}})
    assert again.sha256 == profile.sha256
    assert parse_profile({"name": "mine", **of({"origin": 1})}).sha256 != profile.sha256
    for built_in in BUILT_IN.values():
        assert parse_profile(built_in.to_dict()) == built_in


@pytest.mark.parametrize(
    "wrong",
    [
        {"frams": {}},
        {"row": {"column": "Y", "unit": "cm"}},
        {"row": None},
        {"name": "Two words"},
        {"version": 0},
        {"frames": {"by": "time"}},
        {"time": {"column": "T", "constant": "2026-01-01"}},
        {"time": {"column": "T", "system": "on_board", "form": "seconds"}},
        {"quaternion": {"columns": ["A"]}},
        {"wide": {"count": 1_000_000}},
        {"layout": {"format": "ragged"}},
        {"time": {"column": "T", "system": "on_board", "form": "seconds", "epoch": " "}},
        {"time": {"column": "T", "offset_s": 1e300}},
        {"time": {"column": "T", "offset_s": "nan"}},
        {"row": {"column": "Y", "origin": "nan"}},
        {"quaternion": {"mounting": [0, 0, "inf", 1]}},
        {"detector": {"rows": 10**40}},
        {"detector": {"columns": -5}},
        {"detector": {"pixel_pitch_m": 5e-324}},
        {"layout": {"extension": 10**30}},
        {"sigma": {"columns": []}},
        {"description": "x" * 10_000},
    ],
)
def test_a_profile_that_cannot_be_meant_is_refused(wrong):
    with pytest.raises(RefusedInputError):
        parse_profile({"name": "mine", **LONG, **wrong})
