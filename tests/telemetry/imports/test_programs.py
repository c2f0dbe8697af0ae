"""Each built-in profile against a file that its program, or an independent writer, wrote."""

import io
import json
import re
from pathlib import Path

import astropy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, SkyCoord
from astropy.io import ascii as text_tables
from astropy.table import Table
from astropy.time import Time

from boresight.estimation.attitude import conjugate, product
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.sensors import parse_sensor
from tests.telemetry.imports.conftest import VECTORS

#: A bright star of the image that astrometry.net, SExtractor and photutils were given: row and column, 0 = a pixel's centre.
BRIGHTEST = (1004.6, 103.1)
ASTROPY = Path(astropy.__file__).parent


def nearest(telemetry, place):
    away = np.hypot(telemetry.row_px - place[0], telemetry.col_px - place[1])
    return float(away.min())


@pytest.mark.parametrize(
    ("name", "profile", "stars"),
    [
        ("astrometry-net.axy", "astrometry-axy", 40),
        ("astrometry-net.corr", "astrometry-corr", 7),
        ("sextractor.cat", "sextractor", 9),
        ("sextractor.cat", "sextractor-win", 9),
        ("sextractor-ldac.fits", "sextractor", 9),
        ("photutils.ecsv", "photutils", 17),
    ],
)
def test_three_programs_put_the_same_star_in_the_same_pixel(load, name, profile, stars):
    telemetry = load(VECTORS / name, profile).telemetry
    assert len(telemetry) == stars
    assert nearest(telemetry, BRIGHTEST) < 0.25  # a wrong origin would be off by half a pixel in both, 0.7 px
    assert np.all(telemetry.frame == 0)


def test_a_list_of_positions_is_read_as_astropy_wrote_it(load, tmp_path):
    x, y = np.array([1.0, 200.5, 512.25]), np.array([1.0, 40.75, 300.0])
    Table({"X": x, "Y": y}).write(tmp_path / "list.xyls", format="fits")
    telemetry = load(tmp_path / "list.xyls", "astrometry-xyls").telemetry
    np.testing.assert_allclose(telemetry.col_px, x - 1)
    np.testing.assert_allclose(telemetry.row_px, y - 1)


def test_places_of_an_index_become_apparent_where_a_time_is_known_and_are_kept_beside_where_none_is(load):
    without = load(VECTORS / "astrometry-net.corr", "astrometry-corr").telemetry
    assert without.ra_rad is None
    assert float(without.unknown["catalogue_ra_deg"][0].as_py()) == pytest.approx(184.0007782)
    seen = load(VECTORS / "astrometry-net.corr", "astrometry-corr", time="2017-05-08T03:00:00Z").telemetry
    ra = [float(cell.as_py()) for cell in without.unknown["catalogue_ra_deg"]]
    dec = [float(cell.as_py()) for cell in without.unknown["catalogue_dec_deg"]]
    gcrs = SkyCoord(ra, dec, unit="deg").transform_to(GCRS(obstime=Time("2017-05-08T03:00:00", scale="utc")))
    found = SkyCoord(
        np.degrees(seen.ra_rad), np.degrees(seen.dec_rad), unit="deg", frame=gcrs.frame.replicate_without_data()
    )
    assert np.all(found.separation(gcrs) < 0.02 * u.arcsec)  # light deflection is left out
    assert np.all(
        SkyCoord(ra, dec, unit="deg").separation(
            SkyCoord(np.degrees(seen.ra_rad), np.degrees(seen.dec_rad), unit="deg")
        )
        > 5 * u.arcsec
    )


def test_variances_of_sextractor_become_one_standard_deviation(load):
    telemetry = load(VECTORS / "sextractor.cat", "sextractor-win").telemetry
    table = text_tables.read(VECTORS / "sextractor.cat", format="sextractor")
    np.testing.assert_allclose(telemetry.sigma_px**2, (table["ERRX2WIN_IMAGE"] + table["ERRY2WIN_IMAGE"]) / 2)


@pytest.mark.parametrize("name", ["sextractor2.dat", "sextractor3.dat"])
def test_tables_that_astropy_ships_are_read(load, name):
    path = ASTROPY / "io" / "ascii" / "tests" / "data" / name
    if not path.exists():
        pytest.skip("astropy is installed without its tests")
    profile = {"frames": {"by": "file"}, "row": {"column": "Y_MAMA|YWIN_IMAGE"}, "col": {"column": "X_MAMA|XWIN_IMAGE"}}
    if name == "sextractor2.dat":
        telemetry = load(path, profile).telemetry
        assert telemetry.row_px.tolist() == [11.911, 4.872, 10.382, 4.966, 3.956]


def test_solutions_of_cedar_name_stars_and_count_pixels_from_a_corner(load):
    said = json.loads((VECTORS / "cedar-solve.json").read_text())[0]
    made = load(VECTORS / "cedar-solve.json", "tetra3")
    telemetry = made.telemetry
    assert telemetry.star_id.tolist() == said["matched_catID"]
    np.testing.assert_allclose(np.column_stack([telemetry.row_px, telemetry.col_px]) + 0.5, said["matched_centroids"])
    moved = np.degrees(telemetry.ra_rad) - np.array(said["matched_stars"])[:, 0]
    assert np.all(np.abs(moved) * 3600 < 25)
    assert np.any(np.abs(moved) * 3600 > 5)  # they were places of a catalogue


def test_solutions_of_tetra3rs_have_the_attitude_of_the_simulated_sensor(load, sensor_of_the_scenario):
    telemetry = load(VECTORS / "tetra3rs.jsonl", "tetra3rs", sensor=sensor_of_the_scenario).telemetry
    assert len(np.unique(telemetry.frame)) == 2
    truth = [0.40563006, 0.60669821, 0.30474477, 0.61197399]  # of frame 3 of st16-1 with seed 7, right-handed
    turn = product(telemetry.quaternion[:1], conjugate(np.array([truth])))[0]
    assert 2 * np.linalg.norm(turn[:3]) < 0.01
    first = json.loads((VECTORS / "tetra3rs.jsonl").read_text().splitlines()[0])["centroids"][0]
    assert telemetry.col_px[0] == pytest.approx(first[0] + (2592 - 1) / 2)
    assert telemetry.row_px[0] == pytest.approx(first[1] + (1944 - 1) / 2)


@pytest.fixture
def sensor_of_the_scenario(document):
    return parse_sensor({**document, "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6}, "initial": {
        **document["initial"], "f_m": 0.016, "m0_px": 972.0, "n0_px": 1296.0}})  # fmt: skip


def test_lines_of_openstartracker_are_images_of_triples(load):
    telemetry = load(VECTORS / "openstartracker.csv", "openstartracker").telemetry
    lines = (VECTORS / "openstartracker.csv").read_text().splitlines()
    assert np.bincount(telemetry.frame).tolist() == [len(line.split(",")) // 3 for line in lines]
    numbers = [float(cell) for cell in lines[1].split(",")]
    second = telemetry.frame == 1
    assert telemetry.col_px[second].tolist() == numbers[0::3]
    assert telemetry.row_px[second].tolist() == numbers[1::3]
    assert telemetry.magnitude[second].tolist() == numbers[2::3]


NAMES = ("STAR1_ROW", "STAR1_COL", "STAR2_ROW", "STAR2_COL", "Q_X", "Q_Y", "Q_Z", "Q_W")
ROWS = """
2026-11-20T01:02:03.000Z\t10.5\t20.25\t30\t40\t\t\t\t
2026-11-20T01:02:03.500Z\t\t\t\t\t0\t0\t0\t1
2026-11-20T01:02:04.000Z\t11.5\t21.25\t\t\t0\t0\t0.6\t0.8
"""
YAMCS = "\t".join(["Time", *(f"/acme/st/{name}" for name in NAMES)]) + ROWS


def test_an_export_of_yamcs_is_a_frame_a_packet_and_quaternions_of_other_packets_are_joined(load):
    text = YAMCS.replace(
        "2026-11-20T01:02:03.000Z\t10.5\t20.25\t30\t40\t\t\t\t\n",
        "2026-11-20T01:02:03.000Z\t\t\t\t\t0\t0\t0\t1\n2026-11-20T01:02:03.250Z\t10.5\t20.25\t30\t40\t\t\t\t\n",
    )
    telemetry = load(text, "yamcs", name="st.tsv").telemetry
    assert telemetry.row_px.tolist() == [10.5, 30.0, 11.5]
    assert telemetry.col_px.tolist() == [20.25, 40.0, 21.25]
    assert len(np.unique(telemetry.frame)) == 2
    assert telemetry.quaternion[0].tolist() == [0, 0, 0, 1]
    assert telemetry.quaternion[2].tolist() == pytest.approx([0, 0, 0.6, 0.8])
    assert str(telemetry.time_utc[0]) == "2026-11-20T01:02:03.250000"


def test_what_the_data_extractor_of_cosmos_writes_is_read(load):
    text = (
        "TIME,TARGET,PACKET,STAR1_ROW,STAR1_COL,STAR1_MAG,STAR2_ROW,STAR2_COL,STAR2_MAG,TEMPERATURE\n"
        "2026-11-20T01:02:03.123456789Z,ST,STARS,1.5,2.5,4.1,3.5,4.5,5.0,20.5\n"
        "2026-11-20T01:02:04.123456789Z,ST,STARS,1.25,2.75,4.1,,,,20.5\n"
    )
    telemetry = load(text, "openc3").telemetry
    assert telemetry.row_px.tolist() == [1.5, 3.5, 1.25]
    assert telemetry.magnitude.tolist() == [4.1, 5.0, 4.1]
    assert telemetry.temperature_c.tolist() == [20.5] * 3
    assert str(telemetry.time_utc[0]) == "2026-11-20T01:02:03.123456"


def contract_table():
    return Table(
        {
            "frame": np.array([0, 0, 1], np.int32),
            "exposure": np.zeros(3, np.int16),
            "row_px": np.array([1.5, 7.25, 3.0]),
            "col_px": np.array([2.5, 8.0, 4.0], np.float32),
            "time_utc": ["2026-11-20T00:00:00Z"] * 2 + ["2026-11-20T00:00:01Z"],
            "star_id": np.array([677, 0, 1067]),
        }
    )


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("t.fits", "fits"),
        ("t.vot", "votable"),
        ("t.ecsv", "ascii.ecsv"),
        ("t.csv", "ascii.csv"),
        ("t.parquet", None),
        ("t.jsonl", None),
    ],
)
def test_a_table_of_any_format_is_the_same_telemetry(load, tmp_path, name, form):
    table = contract_table()
    if form is not None:
        table.write(tmp_path / name, format=form)
    else:
        columns = {column: table[column].tolist() for column in table.colnames}
        if name.endswith("parquet"):
            arrow_parquet.write_table(pa.table(columns), tmp_path / name)
        else:
            rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
            (tmp_path / name).write_text("".join(json.dumps(row) + "\n" for row in rows))
    telemetry = load(tmp_path / name, "contract").telemetry
    assert telemetry.frame.tolist() == [0, 0, 1]
    assert telemetry.col_px.tolist() == [2.5, 8.0, 4.0]
    assert telemetry.star_id.tolist() == [677, 0, 1067]
    assert str(telemetry.time_utc[2]) == "2026-11-20T00:00:01.000000"


def test_a_vector_column_of_fits_is_a_wide_table(load, tmp_path):
    table = Table(
        {"T": [100.0, 101.0], "X": np.array([[1.0, 2.0], [3.0, 0.0]]), "Y": np.array([[5.0, 6.0], [7.0, 0.0]])}
    )
    table.write(tmp_path / "wide.fits")
    profile = {
        "wide": {"count": 2, "absent": 0.0},
        "frames": {"by": "record"},
        "row": {"column": "Y_{n}"},
        "col": {"column": "X_{n}"},
        "time": {"column": "T", "system": "gps", "form": "seconds"},
    }
    telemetry = load(tmp_path / "wide.fits", profile).telemetry
    assert telemetry.col_px.tolist() == [1.0, 2.0, 3.0]
    assert telemetry.frame.tolist() == [0, 0, 1]
    assert str(telemetry.time_utc[0]) == "1980-01-06T00:01:40.000000"


def test_every_built_in_profile_is_held_against_a_file_of_its_program():
    here = Path(__file__).read_text().replace('== ["packets"]', "")
    assert [name for name in BUILT_IN if not re.search(rf'"{name}"', here)] == ["packets"]  # told in test_mapping.py


def test_the_table_of_a_votable_is_that_of_astropy(load):
    written = io.BytesIO()
    contract_table().write(written, format="votable")
    assert len(load(written.getvalue(), "contract", name="t.xml").telemetry) == 3
