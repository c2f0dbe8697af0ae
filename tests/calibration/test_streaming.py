"""A set taken from a file in pieces gives the bits that it gives in memory, whatever the pieces and whoever computes them."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.calibration import calibrate as calibration
from boresight.calibration import telemetry_pieces
from boresight.calibration.matching import matched
from boresight.calibration.telemetry_pieces import TelemetryFile, copy_stretch
from boresight.errors import CancelledError
from boresight.estimation.blocks import FRAMES
from boresight.estimation.executor import LocalExecutor
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.read.readers import write_parquet
from tests.calibration.conftest import telemetry
from tests.calibration.rematched import sky
from tests.calibration.streamed import differences, in_memory, streamed, written

#: Two blocks and a bit.
LONG = 2 * FRAMES + 100


class Elsewhere:
    def map(self, function, arguments, **_):
        results = {}
        for k in [*reversed(range(len(arguments))), *range(len(arguments))]:
            call, piece = pickle.loads(pickle.dumps((function, arguments[k])))  # noqa: S301 - made here
            results[k] = pickle.loads(pickle.dumps(call(*piece)))  # noqa: S301 - made here
        return [results[k] for k in range(len(arguments))]


@pytest.fixture(scope="module")
def long_set(tmp_path_factory):
    return written(telemetry(5, frames=LONG, stars=5, exposures=1), tmp_path_factory.mktemp("long"))


@pytest.fixture
def unjudged():
    with mock.patch("boresight.calibration.calibrate.evaluate_result"):
        yield


@pytest.mark.parametrize(
    "choices",
    [
        {},
        {"robust": "huber"},
        {"error": "cosine"},
        {"method": "sqrf"},
        {"method": "sqrf", "variant": "q"},
        {"method": "svd"},
    ],
    ids=str,
)
@pytest.mark.usefixtures("unjudged")
def test_every_method_gives_the_same_bits_from_a_file_in_pieces(choices, long_set, sensor, catalogue):
    choices = {"match": "given", **choices}
    whole = in_memory(long_set[1], sensor, catalogue, **choices)
    pieces = streamed(long_set[0], sensor, catalogue, 700, **choices)
    assert whole["status"] == "converged"
    assert differences(whole, pieces) == []


def test_no_size_of_the_pieces_changes_a_bit(long_set, sensor, catalogue):
    with mock.patch("boresight.calibration.calibrate.evaluate_result"):
        whole = in_memory(long_set[1], sensor, catalogue, match="given")

        @settings(max_examples=5, deadline=None)
        @given(st.integers(1, LONG + 1).map(lambda frames: max(frames, 40)))
        def same(frames):
            found = streamed(long_set[0], sensor, catalogue, frames, match="given")
            assert differences(whole, found) == []

        same()


@pytest.mark.parametrize("choices", [{}, {"method": "sqrf"}, {"match_rule": "flight"}], ids=str)
def test_matches_that_follow_the_estimate_are_the_same_from_a_file_in_pieces(choices, catalogue, tmp_path, monkeypatch):
    monkeypatch.setattr(matched, "MATCHED_FRAMES", 32)
    field = sky(catalogue, 3, 70)
    path, named = written(field.blanked(0.3), tmp_path)
    whole = in_memory(named, field.sensor, catalogue, **choices)
    pieces = streamed(path, field.sensor, catalogue, 23, **choices)
    assert whole["matching"]["cycles"]
    assert differences(whole, pieces) == []


def test_directions_from_the_catalogue_and_the_other_camera_are_the_same_too(catalogue, tmp_path):
    scenario = calibration_scenario(2, 60)
    path, named = written(simulate(scenario, np.random.default_rng(4), catalogue), tmp_path)
    whole = in_memory(named, st16_sensor(2), catalogue, match="given")
    pieces = streamed(path, st16_sensor(2), catalogue, 7, match="given")
    assert differences(whole, pieces) == []


@pytest.mark.usefixtures("unjudged")
def test_pieces_that_travel_and_are_computed_twice_give_the_same_bits(long_set, sensor, catalogue):
    whole = in_memory(long_set[1], sensor, catalogue, match="given")
    pieces = streamed(long_set[0], sensor, catalogue, 500, match="given", spread=Elsewhere())
    assert differences(whole, pieces) == []


@pytest.mark.usefixtures("unjudged")
def test_two_that_compute_the_same_pieces_at_once_do_no_harm(long_set, sensor, catalogue):
    whole = in_memory(long_set[1], sensor, catalogue, match="given")

    class AtOnce:
        def map(self, function, arguments, **_):
            with ThreadPoolExecutor(4) as pool:
                twice = list(pool.map(lambda piece: function(*piece), [*arguments, *arguments]))
            return twice[: len(arguments)]

    pieces = streamed(long_set[0], sensor, catalogue, 500, match="given", spread=AtOnce())
    assert differences(whole, pieces) == []


def odd_sets():
    base = telemetry(6, frames=30)
    return {
        "one frame": telemetry(6, frames=1),
        "pieces without a usable frame": replace(base, star_id=np.where(base.frame // 10 == 1, 0, base.star_id)),
        "nothing usable at its ends": replace(base, star_id=np.where(base.frame % 29 == 0, 0, base.star_id)),
        "one exposure a frame": telemetry(6, frames=30, exposures=1),
        "nothing usable": telemetry(6, frames=30, stars=3),
        "numbered with gaps": replace(base, frame=base.frame**2 * 7),
    }


@pytest.mark.parametrize("name", odd_sets())
def test_odd_sets_give_the_same_document(name, sensor, catalogue, tmp_path):
    path, odd = written(odd_sets()[name], tmp_path)
    assert differences(
        in_memory(odd, sensor, catalogue, match="given"), streamed(path, sensor, catalogue, 5, match="given")
    ) == []  # fmt: skip
    assert [entry.name for entry in tmp_path.iterdir()] == ["set.parquet"]


def test_what_another_machine_cannot_read_is_read_here(sensor, catalogue, tmp_path):
    path, whole = written(telemetry(8, frames=60), tmp_path)
    asked = []

    class Blind(LocalExecutor):
        def map(self, function, arguments, **choices):
            if function is copy_stretch:
                asked.extend(arguments)
                arguments = [(replace(stretch, path=path.with_name("gone")), *rest) for stretch, *rest in arguments]
            return super().map(function, arguments, **choices)

    found = streamed(path, sensor, catalogue, 4, match="given", spread=Blind())
    assert differences(in_memory(whole, sensor, catalogue, match="given"), found) == []
    assert len(asked) > 2


@pytest.mark.usefixtures("unjudged")
def test_a_file_that_cannot_be_read_apart_gives_the_same_bits(sensor, catalogue, tmp_path):
    path, whole = written(telemetry(8, frames=60), tmp_path, rows_a_group=10_000)
    found = streamed(path, sensor, catalogue, 4, match="given")
    assert differences(in_memory(whole, sensor, catalogue, match="given"), found) == []


def test_times_that_only_some_pieces_have_are_enough(catalogue, tmp_path):
    scenario = calibration_scenario(2, 40)
    bare = simulate(scenario, np.random.default_rng(4), catalogue)
    path, half = written(
        replace(bare, time_utc=np.where(bare.frame < 20, np.datetime64("NaT", "us"), bare.time_utc)), tmp_path
    )
    for match in ("given", "rematch"):
        whole = in_memory(half, st16_sensor(2), catalogue, match=match)
        assert differences(whole, streamed(path, st16_sensor(2), catalogue, 6, match=match)) == []


@pytest.mark.parametrize("match", ["given", "rematch"])
@pytest.mark.parametrize("method", ["batch", "sqrf"])
@pytest.mark.usefixtures("unjudged")
def test_a_stop_is_heard_in_every_phase_and_leaves_nothing_behind(method, match, catalogue, tmp_path):
    field = sky(catalogue, 3, 40)
    asked = []
    run = {"method": method, "match": match, "cancelled": lambda: bool(asked.append(1))}
    path, _ = written(field.telemetry, tmp_path)
    streamed(path, field.sensor, catalogue, 8, **run)
    for after in np.unique(np.linspace(0, len(asked) - 1, 6).astype(int)):
        answers = iter([*[False] * after, True])
        with pytest.raises(CancelledError):
            streamed(path, field.sensor, catalogue, 8, **run | {"cancelled": answers.__next__})
        assert [entry.name for entry in tmp_path.iterdir()] == ["set.parquet"]


@pytest.mark.parametrize(
    ("rows_a_group", "said"), [(100, "read 1 of 8 parts of the file"), (10_000, "read 144 detections")]
)
@pytest.mark.usefixtures("unjudged")
def test_progress_is_told_from_the_first_piece_on_and_never_goes_back(rows_a_group, said, sensor, catalogue, tmp_path):
    heard = []
    path, _ = written(telemetry(9, frames=180), tmp_path, rows_a_group)
    streamed(path, sensor, catalogue, 6, match="given", report=heard.append)
    fractions = [step.fraction for step in heard]
    assert fractions == sorted(fractions)
    assert fractions[0] < 0.1
    assert heard[0].message == said


def test_a_large_set_is_judged_on_evenly_spread_blocks_and_says_so(catalogue, sensor, long_set, monkeypatch):
    monkeypatch.setattr(telemetry_pieces, "JUDGED_WHOLE", 4000)
    monkeypatch.setattr(telemetry_pieces, "JUDGED_STARS", 8000)
    whole = in_memory(long_set[1], sensor, catalogue, match="given")
    pieces = streamed(long_set[0], sensor, catalogue, 333, match="given")
    assert differences(whole, pieces) == []
    assert (whole["judged_on"]["frames"], whole["judged_on"]["of_frames"]) == (FRAMES + 100, LONG)
    assert whole["frames"] == LONG
    assert whole["evaluation"]["frames"] == FRAMES + 100
    assert f"judged on {FRAMES + 100:,} of {LONG:,} frames" in whole["advice"][-1]


def test_a_large_set_matched_anew_is_judged_on_its_own_matches(catalogue, tmp_path, monkeypatch):
    monkeypatch.setattr(telemetry_pieces, "JUDGED_WHOLE", 4000)
    monkeypatch.setattr(telemetry_pieces, "JUDGED_STARS", 2000)
    monkeypatch.setattr(telemetry_pieces, "FRAMES", 20)
    field = sky(catalogue, 3, 200)
    path, named = written(field.blanked(0.3), tmp_path)
    whole = in_memory(named, field.sensor, catalogue)
    pieces = streamed(path, field.sensor, catalogue, 33)
    assert differences(whole, pieces) == []
    assert 0 < whole["judged_on"]["frames"] < whole["frames"]
    assert whole["matching"]["kept"] < whole["stars"]


def test_a_held_out_file_that_is_large_is_sampled_evenly(sensor, catalogue, tmp_path, monkeypatch):
    monkeypatch.setattr(calibration, "JUDGED_STARS", 24 * 50)
    write_parquet(telemetry(3, frames=200), tmp_path / "held-out.parquet")
    held_out = TelemetryFile(tmp_path / "held-out.parquet", large_rows=0, chunk_frames=10)
    document = in_memory(telemetry(1), sensor, catalogue, match="given", validation=held_out)
    assert 25 <= document["validation"]["frames"] <= 50
    assert f"{document['validation']['frames']} of its frames" in document["advice"][-1]


def test_pieces_are_asked_for_a_stop_before_each():
    left = iter([False, False, True])
    with pytest.raises(CancelledError, match="after 2 of 3 pieces"):
        LocalExecutor(lambda: next(left)).map(abs, [(1,), (-2,), (3,)])
