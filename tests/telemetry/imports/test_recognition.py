"""What another program's file is, told by its first bytes, leads to its import; and profiles drafted from its columns."""

import json

import numpy as np
import pytest
from astropy.table import Table

from boresight.errors import RefusedInputError
from boresight.images.reading import read_size
from boresight.telemetry.imports.profile import parse_profile
from boresight.telemetry.imports.recognition import draft_profile, recognise_table
from boresight.telemetry.read.readers import read_telemetry
from tests.telemetry.imports.conftest import VECTORS

STARS = {"frame": [0, 0], "exposure": [0, 0], "row_px": [1.5, 20.25], "col_px": [3.0, 4.5]}
WIDE = "TIME,STAR1_ROW,STAR1_COL,STAR2_ROW,STAR2_COL\n2026-01-01T00:00:00Z,1.5,2,3,4\n"
GERMAN = "frame;exposure;row_px;col_px\n0;0;1,5;3\n0;0;20,25;4,5\n"
OWN = "Row,Col,Time,mag\n10.5,20.25,2026-01-01T00:00:00Z,4.5\n11.5,30.25,2026-01-01T00:00:01Z,4.6\n"


def write(place, content):
    place.write_text(content)
    return place


@pytest.mark.parametrize(
    ("name", "profile"),
    [
        ("astrometry-net.axy", "astrometry-axy"),
        ("astrometry-net.corr", "astrometry-corr"),
        ("sextractor.cat", "sextractor-win"),
        ("photutils.ecsv", "photutils"),
        ("tetra3rs.jsonl", "tetra3rs"),
        ("cedar-solve.json", "tetra3"),
    ],
)
def test_a_file_of_another_program_leads_to_its_profile(name, profile):
    with pytest.raises(RefusedInputError, match=f"boresight import {name} --profile {profile} "):
        read_telemetry(VECTORS / name)


def test_tables_in_other_containers_lead_to_the_import(tmp_path):
    for name, form in (("t.fits", "fits"), ("t.xml", "votable")):
        Table(STARS).write(tmp_path / name, format=form)
        with pytest.raises(RefusedInputError, match="--profile contract "):
            read_telemetry(tmp_path / name)
    with pytest.raises(RefusedInputError, match="--profile contract "):
        read_size(tmp_path / "t.fits", "t.fits")


@pytest.mark.parametrize(
    ("content", "words"),
    [(WIDE, "--profile openc3 "), (GERMAN, "semicolons.*--profile contract "), (OWN, "own.csv --print-profile")],
)
def test_a_text_of_other_columns_leads_to_the_import(tmp_path, content, words):
    with pytest.raises(RefusedInputError, match=words):
        read_telemetry(write(tmp_path / "own.csv", content))


def test_telemetry_with_a_fault_of_its_own_keeps_its_refusal(tmp_path):
    broken = write(tmp_path / "t.csv", "frame,exposure,row_px,col_px\n0,0,one,2\n")
    with pytest.raises(RefusedInputError, match="row 2") as refused:
        read_telemetry(broken)
    assert "import" not in str(refused.value)


def test_semicolons_and_decimal_commas_are_recognised_and_may_be_declared(load):
    told = {
        "layout": {"format": "text", "separator": ";", "decimal": ","},
        "frames": {"column": "frame"}, "row": {"column": "row_px"}, "col": {"column": "col_px"},
    }  # fmt: skip
    for profile in ("contract", told):
        made = load(GERMAN, profile).telemetry
        np.testing.assert_array_equal(made.row_px, [1.5, 20.25])
        np.testing.assert_array_equal(made.col_px, [3.0, 4.5])
    with pytest.raises(RefusedInputError, match="decimal"):
        parse_profile({"name": "mine", **told, "layout": {"format": "text", "decimal": ","}})


def test_a_profile_is_drafted_from_names_and_reads_the_file(load, tmp_path):
    draft = draft_profile(recognise_table(write(tmp_path / "own.csv", OWN), "own.csv"))
    assert (draft.profile.row.column, draft.profile.col.column) == ("Row", "Col")
    assert (draft.profile.time.column, draft.profile.magnitude.column) == ("Time", "mag")
    assert draft.profile.frames.by == "time"
    assert any("origin" in one for one in draft.still)
    made = load(OWN, {**draft.profile.to_dict()}).telemetry
    np.testing.assert_array_equal(made.row_px, [10.5, 11.5])
    assert made.frame.tolist() == [0, 1]


def test_numbered_columns_are_drafted_as_a_wide_table(load, tmp_path):
    text = "utc,s0_y,s0_x,s1_y,s1_x\n2026-01-01T00:00:00Z,1.5,2,3,4\n"
    draft = draft_profile(recognise_table(write(tmp_path / "w.csv", text), "w.csv"))
    assert (draft.profile.wide.count, draft.profile.wide.first) == (2, 0)
    assert load(text, draft.profile.to_dict()).telemetry.col_px.tolist() == [2.0, 4.0]


def test_nested_json_lines_are_drafted_star_by_star(load, tmp_path):
    line = json.dumps({"time": "2026-01-01T00:00:00Z", "stars": [{"x": 1.0, "y": 2.0}, {"x": 3.0, "y": 4.0}]})
    path = write(tmp_path / "n.jsonl", line + "\n")
    with pytest.raises(RefusedInputError, match=r"boresight import n\.jsonl"):
        read_telemetry(path)
    draft = draft_profile(recognise_table(path, "n.jsonl"))
    assert load(line, draft.profile.to_dict(), "n.jsonl").telemetry.row_px.tolist() == [2.0, 4.0]


def test_columns_that_are_no_coordinates_are_not_guessed(tmp_path):
    found = recognise_table(write(tmp_path / "a.csv", "a,b\n1,2\n"), "a.csv")
    assert found.profile is None
    with pytest.raises(RefusedInputError, match="none of which"):
        draft_profile(found)
