"""The frames part of a run page: the view is in the address, numbers are those of the API, and what is missing is said."""

import dataclasses
import re

import numpy as np
import pytest

from boresight.console.runs.pages.frames import SCALES, FramePage, round_down, usual_scale
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.writing import write_parquet
from tests.sites import codes, text_of


@pytest.fixture(scope="module")
def table(tmp_path_factory, catalogue):
    path = tmp_path_factory.mktemp("table") / "table.parquet"
    scenario = dataclasses.replace(calibration_scenario(1), frames=40)
    write_parquet(simulate(scenario, np.random.default_rng(1), catalogue), path)
    return path


@pytest.fixture
def site(site, table, catalogue):
    site.app.state.catalogue = lambda: catalogue
    with open_writing(site.engine) as session:
        sha256 = site.blobs.put(table)
        register_blob(session, site.blobs, sha256, "application/vnd.apache.parquet")
        session.get_one(TelemetrySet, 1).table_sha256 = sha256
        audit.append(session, COMMAND_LINE, "brought in", "telemetry-sets/1")
    return site


@pytest.fixture
def run_id():
    return 1  # the batch of the furnished store


def frames_page(site, run_id, **query):
    address = "&".join(f"{name}={value}" for name, value in {"part": "evidence", "frame": "", **query}.items())
    return site.visitor("victor").get(f"/runs/{run_id}?{address}")


def test_a_frame_opens_from_its_address_with_scale_exposure_and_parameters(site, read, run_id):
    page = frames_page(site, run_id, frame=7, exposure=1, scale=500, show="both")
    text = read(page)
    assert "Frame 7" in text
    assert text_of(page, "frame-drawing-title").endswith("exposure 1")
    assert 'data-scale="500"' in page
    assert len(re.findall('<line class="old"', page)) == len(re.findall('<line class="new"', page)) > 3
    assert "frame=8&amp;exposure=1&amp;scale=500&amp;show=both" in page  # the next one looks the same
    assert "frame=6&amp;" in page


def test_the_drawing_s_vectors_are_the_table_s_residuals_at_the_stated_scale(site, read, run_id):
    page = frames_page(site, run_id, frame=7, scale=1000)
    line = re.search(
        r'<line class="new" x1="([^"]+)" y1="([^"]+)" x2="([^"]+)" y2="([^"]+)" data-dx="([^"]+)" data-dy="([^"]+)"',
        page,
    )
    x1, y1, x2, y2, dx, dy = map(float, line.groups())
    assert (x2 - x1, y2 - y1) == pytest.approx((1000 * dx, 1000 * dy))
    assert f"{dy:.3f}".replace("-", "\u2212") in read(page)


def test_without_a_frame_the_worst_one_opens_and_the_worst_are_listed_first(site, read, run_id, results):
    trust = results["batch"]["trust"]
    worst = trust["worst_frames"]["frame"] if trust.get("worst_frames") else None
    page = frames_page(site, run_id)
    assert "Worst frames" in read(page)
    if worst:
        assert re.search(rf"<h2>(<[^>]+>)?Frame(</a>)? {worst[0]}</h2>", page)


def test_a_frame_that_is_not_there_says_which_there_are(site, read, run_id):
    page = frames_page(site, run_id, frame=4000)
    assert ("no-such-frame" in codes(page), "0 to 39" in read(page)) == (True, True)
    assert "not-a-frame-number" in codes(frames_page(site, run_id, frame="abc"))


def test_a_queued_run_shows_its_frames_under_the_parameters_it_has(site):
    page = frames_page(site, site.add_run("batch"), frame=3)
    assert "no-new-parameters" in codes(page)
    assert 'id="frame-drawing-title"' in page


def test_missing_telemetry_is_said_and_the_page_still_opens(site, run_id):
    with open_writing(site.engine) as session:
        table = session.get_one(TelemetrySet, 1).table_sha256
    site.blobs.path(table).unlink()
    assert "missing-file" in codes(frames_page(site, run_id, frame=3))


def test_the_usual_scale_shows_the_typical_residual_as_three_hundredths_of_the_width():
    star = {"fate": "used", "new": {"d_px": [0.03, 0.04]}, "old": None}
    assert usual_scale([star] * 5, ["new"], 2592) == 1000  # 0.05 px is drawn 50 px long
    assert usual_scale([], ["new"], 2592) == 1
    assert list(SCALES[:4]) == [1, 2, 5, 10]


@pytest.mark.parametrize(("value", "rounded"), [(1.0, 1.0), (0.19, 0.1), (499, 200), (5.0, 5.0), (0.00052, 0.0005)])
def test_scale_bars_are_round(value, rounded):
    assert round_down(value) == pytest.approx(rounded)


def test_addresses_leave_out_what_is_taken_away():
    page = FramePage(address={"frame": "3", "exposure": "1"})
    assert page.to(exposure=None, frame=4) == "?part=evidence&frame=4"
