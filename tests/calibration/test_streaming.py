"""A set taken from a file in pieces gives the bits and the refusals that it gives in memory, whoever computes the pieces."""

import json
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.stars import write_synthetic
from boresight.calibration import calibrate as calibration
from boresight.calibration import telemetry_pieces
from boresight.calibration.matching import matched
from boresight.calibration.telemetry_pieces import StoredTable, TelemetryFile, copy_stretch
from boresight.columns import write_columns
from boresight.disks import compute_digest
from boresight.errors import CancelledError, CorruptFileError, RefusedInputError
from boresight.estimation.blocks import FRAMES
from boresight.estimation.executor import LocalExecutor
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import select_rows
from boresight.telemetry.working_table import WorkingTable, WorkingTableParts
from boresight.telemetry.writing import write_parquet
from tests.calibration.conftest import telemetry
from tests.calibration.sets import differences, in_memory, same_in_pieces, sky, streamed, write_in_groups, written
from tests.refusals import has_code
from tests.working_tables import write_working_table

#: Two blocks and a bit.
LONG = 2 * FRAMES + 100


class Elsewhere:
    def map(self, function, arguments, **_):
        results = {}
        for k in [*reversed(range(len(arguments))), *range(len(arguments))]:
            call, piece = pickle.loads(pickle.dumps((function, arguments[k])))  # noqa: S301 - made here
            results[k] = pickle.loads(pickle.dumps(call(*piece)))  # noqa: S301 - made here
        return [results[k] for k in range(len(arguments))]


class TwiceAtOnce:
    def map(self, function, arguments, **_):
        with ThreadPoolExecutor(4) as pool:
            twice = list(pool.map(lambda piece: function(*piece), [*arguments, *arguments]))
        return twice[: len(arguments)]


@pytest.fixture(scope="module")
def long_set(tmp_path_factory):
    return written(telemetry(5, frames=LONG, stars=5, exposures=1), tmp_path_factory.mktemp("long"))


@pytest.fixture
def unjudged():
    with mock.patch("boresight.calibration.calibrate.evaluate_result", lambda found, *_, **__: found):
        yield


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("choices", "frames"),
    [
        ({}, 700),
        ({"robust": "huber"}, 700),
        ({"error": "cosine"}, 700),
        ({"method": "sqrf"}, 700),
        ({"method": "sqrf", "variant": "q"}, 700),
        ({"method": "svd"}, 700),
        ({"executor": Elsewhere()}, 500),  # pieces travel and are computed twice
        ({"executor": TwiceAtOnce()}, 500),
    ],
    ids=["batch", "huber", "cosine", "sqrf", "q", "svd", "elsewhere", "at once"],
)
@pytest.mark.usefixtures("unjudged")
def test_every_method_gives_the_same_bits_from_a_file_in_pieces_whoever_computes_them(
    choices, frames, long_set, sensor, catalogue
):
    assert same_in_pieces(*long_set, sensor, catalogue, frames, match="given", **choices)["status"] == "converged"


@pytest.mark.full
def test_no_size_of_the_pieces_changes_a_bit(long_set, sensor, catalogue):
    with mock.patch("boresight.calibration.calibrate.evaluate_result", lambda found, *_, **__: found):
        whole = in_memory(long_set[1], sensor, catalogue, match="given")

        @settings(max_examples=5, deadline=None)
        @given(st.integers(1, LONG + 1).map(lambda frames: max(frames, 40)))
        def same(frames):
            found = streamed(long_set[0], sensor, catalogue, frames, match="given")
            assert differences(whole, found) == []

        same()


@pytest.mark.few(1)
@pytest.mark.parametrize("choices", [{}, {"method": "sqrf"}, {"match_rule": "flight"}], ids=str)
def test_matches_that_follow_the_estimate_are_the_same_from_a_file_in_pieces(choices, catalogue, tmp_path, monkeypatch):
    monkeypatch.setattr(matched, "MATCHED_FRAMES", 32)
    field = sky(catalogue, 3, 70)
    document = same_in_pieces(*written(field.blanked(0.3), tmp_path), field.sensor, catalogue, 23, **choices)
    assert document["matching"]["cycles"]


def test_directions_from_the_catalogue_are_the_same_too_and_times_that_only_some_pieces_have_enough(
    catalogue, tmp_path
):
    bare = simulate(calibration_scenario(2, 60), np.random.default_rng(4), catalogue)
    half = replace(bare, time_utc=np.where(bare.frame < 20, np.datetime64("NaT", "us"), bare.time_utc))
    for whole, match in ((bare, "given"), (half, "given"), (half, "rematch")):
        same_in_pieces(*written(whole, tmp_path), st16_sensor(2), catalogue, 7, match=match)


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


@pytest.mark.few(3)
@pytest.mark.parametrize("name", odd_sets())
def test_odd_sets_give_the_same_document(name, sensor, catalogue, tmp_path):
    same_in_pieces(*written(odd_sets()[name], tmp_path), sensor, catalogue, 5, match="given")
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

    found = streamed(path, sensor, catalogue, 4, match="given", executor=Blind())
    assert differences(in_memory(whole, sensor, catalogue, match="given"), found) == []
    assert len(asked) > 2


@pytest.mark.usefixtures("unjudged")
def test_a_file_that_cannot_be_read_apart_gives_the_same_bits(sensor, catalogue, tmp_path):
    whole = written(telemetry(8, frames=60), tmp_path, rows_a_group=10_000)
    same_in_pieces(*whole, sensor, catalogue, 4, match="given")


@pytest.mark.few(2)
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
    whole = same_in_pieces(*long_set, sensor, catalogue, 333, match="given")
    assert (whole["judged_on"]["frames"], whole["judged_on"]["of_frames"]) == (FRAMES + 100, LONG)
    assert (whole["frames"], whole["evaluation"]["frames"]) == (LONG, FRAMES + 100)
    assert f"{FRAMES + 100:,} of {LONG:,} frames" in whole["advice"][-1]


def test_a_large_set_matched_anew_is_judged_on_its_own_matches(catalogue, tmp_path, monkeypatch):
    for name, number in (("JUDGED_WHOLE", 4000), ("JUDGED_STARS", 2000), ("FRAMES", 20)):
        monkeypatch.setattr(telemetry_pieces, name, number)
    field = sky(catalogue, 3, 200)
    whole = same_in_pieces(*written(field.blanked(0.3), tmp_path), field.sensor, catalogue, 33)
    assert 0 < whole["judged_on"]["frames"] < whole["frames"]
    assert whole["matching"]["kept"] < whole["stars"]


def test_a_validation_set_that_is_large_is_sampled_evenly(sensor, catalogue, tmp_path, monkeypatch):
    monkeypatch.setattr(calibration, "JUDGED_STARS", 24 * 50)
    write_parquet(telemetry(3, frames=200), tmp_path / "held-out.parquet")
    validation_set = TelemetryFile(tmp_path / "held-out.parquet", large_rows=0, chunk_frames=10)
    document = in_memory(telemetry(1), sensor, catalogue, match="given", validation=validation_set)
    assert 25 <= document["validation"]["frames"] <= 50
    assert document["advice_codes"][-1] == "judged_on"
    assert f" {document['validation']['frames']} " in document["advice"][-1]


def test_pieces_are_asked_for_a_stop_before_each():
    left = iter([False, False, True])
    with pytest.raises(CancelledError, match="2 of 3"):
        LocalExecutor(lambda: next(left)).map(abs, [(1,), (-2,), (3,)])


def refusals():
    base = telemetry(8, frames=30)
    return {
        "stars off the detector": replace(base, row_px=np.where(base.frame % 7 == 3, -90.0, base.row_px)),
        "no time": replace(base, ra_rad=None, dec_rad=None, time_utc=np.full(len(base), np.datetime64("NaT", "us"))),
        "no stars": replace(base, ra_rad=None, dec_rad=None, star_id=None),
    }


@pytest.mark.few(3)
@pytest.mark.parametrize("rows_a_group", [100, 10_000], ids=["read apart", "read from its start"])
@pytest.mark.parametrize("name", refusals())
def test_what_is_refused_in_memory_is_refused_in_the_same_words(name, rows_a_group, sensor, catalogue, tmp_path):
    said = []
    path, refused = written(refusals()[name], tmp_path, rows_a_group)
    for run in (
        lambda: in_memory(refused, sensor, catalogue, match="given"),
        lambda: streamed(path, sensor, catalogue, 4, match="given"),
    ):
        with pytest.raises(RefusedInputError) as refusal:
            run()
        said.append((str(refusal.value), refusal.value.faults))
    assert said[0] == said[1]
    assert [entry.name for entry in tmp_path.iterdir()] == ["set.parquet"]


def test_a_file_with_a_fault_is_refused_as_it_is_when_read_at_once(sensor, catalogue, tmp_path):
    whole = telemetry(8, frames=60)
    noise = np.where(whole.frame % 20 == 7, -1.0, 0.4)
    path = write_in_groups(replace(whole, sigma_px=noise), tmp_path, rows_a_group=100)
    with pytest.raises(RefusedInputError) as at_once:
        read_telemetry(path)
    with pytest.raises(RefusedInputError) as in_pieces:
        streamed(path, sensor, catalogue, 4, match="given")
    assert (str(in_pieces.value), in_pieces.value.faults) == (str(at_once.value), at_once.value.faults)
    assert "more faults" in str(at_once.value)


#: Judges few stars, as a set far above the limit would, takes any file in pieces, and says how much was resident at most.
CALIBRATE = """
import resource, sys
from pathlib import Path
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.calibration.matching import matched
from boresight.calibration import telemetry_pieces
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue

telemetry_pieces.JUDGED_WHOLE = telemetry_pieces.JUDGED_STARS = 20_000
matched.BLOCKS_A_RANGE = 1
file = TelemetryFile(Path(sys.argv[1]), large_rows=0, chunk_frames=1024)
settings = CalibrationSettings(method=sys.argv[2], match="given")
found = calibrate(file, st16_sensor(1), load_catalogue(Path(sys.argv[1]).parent), settings)
print(found.frames, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
SMALL, LARGE = 5_000, 30_000
#: What the larger set alone would take in memory: 24 stars of 56 bytes a frame, and 42 arcs with R of 48.
WOULD_TAKE_MB = (LARGE - SMALL) * (24 * 56 + 42 * 48) / 1e6


def peak_mb(path, method):
    done = subprocess.run([sys.executable, "-c", CALIBRATE, path, method], capture_output=True, text=True, check=True)
    frames, peak = done.stdout.split()
    assert int(frames) == json.loads(Path(path).stem)
    return float(peak)


@pytest.mark.full
def test_six_times_the_frames_take_no_more_memory(tmp_path):
    peaks = {}
    for frames in (SMALL, LARGE):
        path = tmp_path / f"{frames}.parquet"
        write_synthetic(path, frames)
        peaks[frames] = peak_mb(path, "batch")
    assert peaks[LARGE] - peaks[SMALL] < WOULD_TAKE_MB / 2


@pytest.mark.few(2)
@pytest.mark.parametrize("large_rows", [0, 10**9])
@pytest.mark.parametrize("shared", [True, False])
def test_a_calibration_of_a_stored_table_parses_checks_and_converts_nothing(tmp_path, catalogue, large_rows, shared):
    field = sky(catalogue, 3, 40)
    path = tmp_path / "table"
    with WorkingTableParts(path) as parts:
        for frames in (field.telemetry.frame < 15, field.telemetry.frame >= 15):
            rows = np.flatnonzero(frames)
            parts.write(select_rows(field.telemetry, slice(rows[0], rows[-1] + 1)))
    stored = StoredTable(path, compute_digest(path), large_rows, shared)
    for match in ("given", "rematch"):
        whole = in_memory(field.telemetry, field.sensor, catalogue, match=match)
        with (
            mock.patch("boresight.telemetry.readers.open_tables", side_effect=AssertionError),
            mock.patch("boresight.telemetry.readers.Checks", side_effect=AssertionError),
            mock.patch("boresight.telemetry.readers.make_arrays", side_effect=AssertionError),
        ):
            found = in_memory(stored, field.sensor, catalogue, match=match, scratch_folder=tmp_path)

        assert differences(whole, found) == []


def test_a_working_copy_or_a_part_of_a_stored_table_that_was_altered_is_refused(tmp_path: Path) -> None:
    arrays = {"row_px": np.linspace(0, 1, 1001), "time_utc": np.array(["2026-11-21"], "M8[us]"), "none": np.empty(0)}
    columns = write_columns(tmp_path / "piece", arrays)
    for name, values in columns.read().items():
        assert np.array_equal(values, arrays[name]), name
    content = bytearray(Path(columns.path).read_bytes())
    content[8000] ^= 1
    Path(columns.path).write_bytes(content)
    with pytest.raises(CorruptFileError, check=has_code("altered-working-copy")):
        columns.read()
    write_working_table(telemetry(1, frames=2), tmp_path / "table")
    with pytest.raises(CorruptFileError) as refused:
        WorkingTable(tmp_path / "table", "0" * 64).part(0)
    assert refused.value.sha256 == "0" * 64
