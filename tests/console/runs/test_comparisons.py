"""Comparisons: what data two runs share decides on the sigma of their difference, and unlike runs are refused."""

import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.runs import comparisons
from boresight.console.runs.comparisons import UnlikeModelsError, compare, document, read_run_ids, table
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import utc_now

NAMES = ["f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y"]


@pytest.fixture
def run_on(session, blobs, finished_run, tmp_path):
    def make(exposures, step=0.0, sigma=1e-6):
        row = finished_run(session)
        place = np.concatenate([np.random.default_rng(number).uniform(0, 1000, (4, 2)) for number in exposures])
        columns = {"frame": np.repeat(exposures, 4), "exposure": np.zeros(4 * len(exposures), dtype=int)}
        path = tmp_path / "table"
        arrow_parquet.write_table(pa.table({**columns, "row_px": place[:, 0], "col_px": place[:, 1]}), path)
        stored = register_blob(session, blobs, blobs.put(path), "application/octet-stream").sha256
        found = session.query(TelemetrySet).filter_by(table_sha256=stored).first()
        if found is None:
            found = TelemetrySet(
                sensor_id=1, name=f"TS-{exposures[0]}-{exposures[-1]}", purpose="calibration", original_sha256=stored,
                table_sha256=stored, frames=len(exposures), stars=len(place), quality={}, uploaded_utc=utc_now(),
            )  # fmt: skip
            session.add(found)
            session.flush()
        matrix = np.diag(np.full(8, sigma**2)).tolist()
        initial = row.sensor_document["initial"]
        made = finished_run(
            session,
            parameters={**initial, "f_m": initial["f_m"] + step},
            sigma=dict.fromkeys(NAMES, sigma),
            covariance={"names": NAMES, "matrix": matrix},
        )
        made.telemetry_set_id = found.id
        session.flush()
        return made.id

    return make


@pytest.mark.parametrize(
    ("exposures", "kind", "sigma"),
    [
        (range(50, 90), "disjoint", math.hypot(1, 2)),
        (range(10), "inside", math.sqrt(4 - 1)),
        (range(20, 60), "partly", math.sqrt(0.5 * 4 + 0.5 * 1)),
    ],
)
def test_the_sigma_of_a_difference_follows_from_the_data_that_are_shared(
    session, blobs, run_on, exposures, kind, sigma
):
    reference = run_on(list(range(40)), sigma=1e-6)
    other = run_on(list(exposures), step=6e-6, sigma=2e-6)
    written = document(compare(session, blobs, [reference, other]))
    assert written["runs"][1]["shared_data"]["kind"] == kind
    row = written["parameters"][0]
    assert row["differences"] == [None, pytest.approx(6e-6)]
    assert row["sigmas_of_difference"] == [None, pytest.approx(sigma * 1e-6)]
    assert row["separations"][1] == pytest.approx(6 / sigma)


def test_two_good_estimates_of_the_same_data_have_no_sigma_between_them(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(40)), step=1e-7)]
    written = document(compare(session, blobs, runs))
    assert written["runs"][1]["shared_data"]["kind"] == "same"
    assert written["parameters"][0]["separations"] == [None, None]
    assert written["runs"][1]["joint"] is None
    assert written["radial"][1]["sigma_px"][10] is None
    assert written["radial"][1]["difference_px"][10] is not None


def test_the_radial_difference_is_that_of_the_focal_lengths(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)), step=1.6e-5)]
    curve = compare(session, blobs, runs).radial()[1]
    at = 60
    assert curve["difference_px"][at] == pytest.approx(-1e-3 * curve["radius_px"][at], rel=2e-3)
    assert compare(session, blobs, runs, runs[1]).radial()[0]["difference_px"][at] == pytest.approx(
        1e-3 * curve["radius_px"][at], rel=2e-3
    )


def test_another_reference_turns_every_difference_round(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)), step=3e-6)]
    there, back = (document(compare(session, blobs, runs, reference))["parameters"][0] for reference in runs)
    assert there["differences"][1] == pytest.approx(-back["differences"][0])
    assert back["differences"][1] is None


def test_the_table_has_one_row_a_parameter_and_run_with_the_reference_first(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)))]
    columns = table(compare(session, blobs, runs, runs[1]))
    assert columns["run"] == [runs[1], runs[0]] * 8
    assert {len(column) for column in columns.values()} == {16}
    assert columns["shared_data"][1] == "disjoint"


def test_a_set_whose_file_is_gone_is_taken_as_separate_and_the_words_say_so(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)))]
    gone = session.query(TelemetrySet).order_by(TelemetrySet.id.desc()).first()
    blobs.path(gone.table_sha256).unlink()
    assert "cannot be read" in compare(session, blobs, runs).sentences[1]


def test_unlike_models_are_refused_with_both_runs_and_what_to_convert(session, blobs, people, finished_run, run_on):
    first, second = run_on(list(range(40))), finished_run(session)
    made = parameter_sets.create_from_run(session, people["ana"], blobs, first)
    second.sensor_document = {**second.sensor_document, "camera_model": "pinhole_radial"}
    session.flush()
    with pytest.raises(UnlikeModelsError, match=f"Run #{first} uses the camera model inverted_wang") as refusal:
        compare(session, blobs, [first, second.id])
    assert refusal.value.sets == [(made.id, made.name)]


def test_what_cannot_be_compared_is_refused(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)))]
    with pytest.raises(RefusedInputError, match="two runs or more"):
        compare(session, blobs, runs[:1])
    with pytest.raises(RefusedInputError, match="none of those compared"):
        compare(session, blobs, runs, 999)
    with pytest.raises(NotFoundError, match="There is no run 999"):
        compare(session, blobs, [*runs, 999])
    with pytest.raises(NotFoundError, match="so great a number"):
        read_run_ids(["9" * 5000])


def test_the_assumption_travels_with_the_numbers(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)))]
    assert document(compare(session, blobs, runs))["assumption"] == comparisons.ASSUMPTION
