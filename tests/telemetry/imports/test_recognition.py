"""What another program's file is, told by its first bytes, leads to its import; and profiles drafted from its columns."""

import gzip
import json

import numpy as np
import pytest
from astropy.table import Table

from boresight.errors import RefusedInputError
from boresight.images.reading import read_size
from boresight.telemetry.imports.profile import parse_profile
from boresight.telemetry.imports.recognition import draft_profile, recognise_for_import, recognise_table
from boresight.telemetry.readers import read_telemetry
from tests.refusals import has_code
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


@pytest.mark.parametrize(("name", "option"), [("example-2.aem", "--attitude"), ("leo-60s.oem", "--orbit")])
def test_a_file_that_belongs_beside_telemetry_says_where(tmp_path, name, option):
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress((VECTORS / name).read_bytes()))
    with pytest.raises(RefusedInputError, match=f" {option} .*`boresight import`"):
        read_telemetry(packed)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (gzip.compress(OWN.encode(), mtime=0)[:-9], "damaged gzip"),
        (gzip.compress(gzip.compress(OWN.encode(), mtime=0), mtime=0), "gzip twice"),
        (gzip.compress(b"", mtime=0), "is empty"),
    ],
)
def test_a_compressed_file_that_cannot_be_read_keeps_its_cause(tmp_path, content, words):
    path = tmp_path / "own.csv.gz"
    path.write_bytes(content)
    with pytest.raises(RefusedInputError, match=words):
        recognise_for_import(path, path.name)


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
    with pytest.raises(RefusedInputError, check=has_code("columns-not-recognised")):
        draft_profile(found)


NUMBERS = "0 255.5 475.25 9.1\n0 72.0 474.5 8.0\n1 155.75 211.5 7.2\n"


@pytest.mark.parametrize(
    ("text", "separator", "comment"),
    [
        (NUMBERS, "space", ""),
        ("# frame x y peak\n" + NUMBERS, "space", "#"),
        (NUMBERS.replace(" ", ","), ",", ""),
        (NUMBERS.replace(" ", "\t"), "tab", ""),
        (NUMBERS.replace(".", ",").replace(" ", ";"), ";", ""),
    ],
)
def test_a_table_without_a_header_is_drafted_by_what_its_cells_look_like(load, tmp_path, text, separator, comment):
    path = write(tmp_path / "n.txt", text)
    with pytest.raises(RefusedInputError, match=r"header.*`?boresight.import n\.txt.--print-profile"):
        read_telemetry(path)
    draft = draft_profile(recognise_table(path, "n.txt"))
    assert (draft.profile.layout.separator, draft.profile.layout.comment) == (separator, comment)
    assert (draft.profile.frames.column, draft.profile.col.column, draft.profile.row.column) == ("1", "2", "3")
    told = "its comment names" if comment else "column 2 is taken for x, column 3 for y and column 1 for the frame"
    assert any(told in one for one in draft.still)
    made = load(text, draft.profile.to_dict(), "n.txt").telemetry
    assert made.frame.tolist() == [0, 0, 1]
    np.testing.assert_array_equal(made.row_px, [475.25, 474.5, 211.5])


@pytest.mark.parametrize(
    ("comment", "row", "magnitude"),
    [
        ("# frame x y mag", "3", "4"),
        ("# made by me\n#frame, x[px], y [px], mag", "3", "4"),
        ("% frame y x mag", "2", "4"),
        ("// frame row col mag", "2", "4"),
        ("# a frame, and x and y of it", "3", None),
        ("# frame x x mag", "3", None),
    ],
)
def test_a_comment_that_names_the_columns_is_believed(load, tmp_path, comment, row, magnitude):
    text = f"{comment}\n{NUMBERS}"
    profile = draft_profile(recognise_table(write(tmp_path / "n.txt", text), "n.txt")).profile
    assert (profile.frames.column, profile.row.column) == ("1", row)
    assert (profile.magnitude and profile.magnitude.column) == magnitude
    assert load(text, profile.to_dict(), "n.txt").telemetry.row_px.tolist() == [
        float(line.split()[int(row) - 1]) for line in NUMBERS.splitlines()
    ]


@pytest.mark.parametrize("separator", [" ", ",", "\t"])
def test_x_and_y_of_a_text_are_not_taken_for_a_fits_table_of_one_image(load, tmp_path, separator):
    text = "\n".join(["frame x y mag", *NUMBERS.splitlines()]).replace(" ", separator)
    found = recognise_table(write(tmp_path / "n.txt", text), "n.txt")
    assert found.profile is None
    assert load(text, draft_profile(found).profile.to_dict(), "n.txt").telemetry.frame.tolist() == [0, 0, 1]
    Table({"frame": [0, 0], "X": [1.5, 2.5], "Y": [3.0, 4.0]}).write(tmp_path / "f.fits")
    assert recognise_table(tmp_path / "f.fits", "f.fits").profile is None


def test_frames_that_have_names_are_numbered_in_their_order(load, tmp_path):
    text = "# from our pipeline\nimage,x,y\nb.fits,1.5,2.5\nb.fits,3.5,4.5\na.fits,1.5,2.5\n"
    draft = draft_profile(recognise_table(write(tmp_path / "n.csv", text), "n.csv"))
    assert draft.profile.frames.by == "name"
    assert load(text, draft.profile.to_dict()).telemetry.frame.tolist() == [0, 0, 1]
    with pytest.raises(RefusedInputError, match=r"row 4\b.*image"):
        load(text.replace("b.fits,3", ",3"), draft.profile.to_dict())


@pytest.mark.parametrize(
    ("rows", "guess"),
    [
        (("1 10.5 20.5 8.1", "2 12.5 21.5 8.2", "3 13.5 2.5 8.3"), {"col": "2", "row": "3"}),
        (("1 0 100.5 200.5", "2 0 120.5 20.5", "3 1 30.5 25.5"), {"frame": "2", "col": "3", "row": "4"}),
        (("0.0e+00 1.505e+02 2.5125e+02", "0.0e+00 1.75e+02 3.0e+01"), {"frame": "1", "col": "2", "row": "3"}),
        (("0 9.1 250.5 470.2", "0 8.1 70.5 470.3"), {"frame": "1", "col": "3", "row": "4"}),
        (("2461000.5 10.5 20.5", "2461000.6 12.5 20.7"), {"time": "1", "col": "2", "row": "3"}),
        (("0 61000.5 10.5 20.5", "0 61000.5 12.5 20.7"), {"frame": "1", "time": "2", "col": "3", "row": "4"}),
        (("2026-01-01 00:00:00 10.5 20.5", "2026-01-01 00:00:01 11.5 20.7"), {"day": "1", "col": "3", "row": "4"}),
    ],
)
def test_clocks_and_numbers_of_stars_are_neither_frames_nor_coordinates(tmp_path, rows, guess):
    assert dict(recognise_table(write(tmp_path / "n.txt", "\n".join(rows)), "n.txt").guess) == guess


def test_numbers_without_coordinates_and_times_beside_them_are_told_apart(tmp_path):
    timed = "2026-01-01T00:00:00Z,10.5,20.5\n2026-01-01T00:00:01Z,11.5,21.5\n"
    assert dict(recognise_table(write(tmp_path / "t.csv", timed), "t.csv").guess) == {
        "time": "1",
        "col": "2",
        "row": "3",
    }
    with pytest.raises(RefusedInputError, match="1, 2, 3"):
        draft_profile(recognise_table(write(tmp_path / "w.csv", "1,2,3\n4,5,6\n"), "w.csv"))


def test_a_table_compressed_by_gzip_is_recognised_as_what_is_inside(load, tmp_path):
    path = tmp_path / "own.csv.gz"
    path.write_bytes(gzip.compress(OWN.encode()))
    found = recognise_table(path, path.name)
    assert found.columns == ("Row", "Col", "Time", "mag")
    assert load(path.read_bytes(), draft_profile(found).profile.to_dict(), path.name).telemetry.row_px.tolist() == [
        10.5,
        11.5,
    ]
    Table(STARS).write(tmp_path / "t.fits", format="fits")
    packed = tmp_path / "t.fits.gz"
    packed.write_bytes(gzip.compress((tmp_path / "t.fits").read_bytes()))
    with pytest.raises(RefusedInputError, match=r"--profile contract --out t-stars\.csv"):
        read_size(packed, packed.name)


def test_a_name_of_thousands_of_digits_is_a_name_like_any_other(tmp_path):
    with pytest.raises(RefusedInputError):
        read_telemetry(write(tmp_path / "digits.csv", "1" * 5000))
