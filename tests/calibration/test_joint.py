"""Several telemetry sets of one sensor as one: exactly the stacked problem, in memory and in pieces, each set once."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.joint.passes import NamedTelemetry, hash_frames, join_sets
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.errors import RefusedInputError
from boresight.estimation import batch
from boresight.telemetry.schema import joined
from boresight.telemetry.working_table import ARRAYS
from tests.calibration.conftest import telemetry
from tests.calibration.sets import differences, written
from tests.estimation.fields import FREE, SCALE, whitened, whitened_plainly, whitened_rows
from tests.refusals import has_code

DAY = np.timedelta64(86_400_000_000, "us")
BEGIN = np.datetime64("2026-01-01", "us")


def a_pass(seed, day=None, frames=40, stars=12, **more):
    """A set whose frames are numbered from 0, as if it knew of no other; after `day` days where that is said."""
    made = telemetry(seed, frames=frames, stars=stars, **more)
    return made if day is None else replace(made, time_utc=BEGIN + day * DAY + made.frame * np.timedelta64(1, "s"))


def together(*sets, large_rows=10**9):
    return join_sets([NamedTelemetry(one, f"pass {k}") for k, one in enumerate(sets)], large_rows)


def stacked(*sets):
    """The same written out by hand: frames numbered through."""
    moved, begins = [], 0
    for one in sets:
        moved.append(replace(one, frame=one.frame + begins))
        begins += int(one.frame[-1]) + 1
    return joined(moved)


def calibrated(sets, sensor, catalogue, **settings):
    return calibrate(sets, sensor, catalogue, CalibrationSettings(**{"match": "given", **settings}))


def same_but_for_passes(one, other):
    one, other = one.to_dict(), other.to_dict()
    one["inputs"].pop("passes", None)
    other["inputs"].pop("passes", None)
    return differences(one, other) == []


@pytest.mark.parametrize("settings", [{}, {"method": "sqrf"}, {"method": "sqrf", "variant": "q"}, {"match": "rematch"}])
def test_a_joint_calibration_is_that_of_the_stacked_set_to_the_last_bit(sensor, catalogue, settings):
    sets = a_pass(1), a_pass(2, frames=25), a_pass(3, frames=30)
    found = calibrated(together(*sets), sensor, catalogue, **settings)
    assert found.status == "converged"
    assert same_but_for_passes(found, calibrated(stacked(*sets), sensor, catalogue, **settings))
    assert [one.frames for one in found.inputs.passes] == [40, 25, 30]
    assert [one.frame_offset for one in found.inputs.passes] == [0, 40, 65]
    assert [one.first_frame for one in found.inputs.passes] == [0, 40, 65]
    assert sum(one.pairs for one in found.inputs.passes) == found.pairs
    assert sum(one.stars for one in found.inputs.passes) == found.stars
    if not settings:
        dof = found.pairs - len(found.free)
        assert sum(one.chi2 for one in found.inputs.passes) / dof == pytest.approx(found.chi2_per_dof, rel=1e-6)


def test_the_fit_is_the_dense_least_squares_of_all_rows_within_1e_9_sigma(sensor, catalogue):
    sets = [a_pass(seed, frames=20) for seed in (4, 5, 6)]
    arcs = build_problem(together(*sets).read(), sensor, catalogue).arcs
    x = sensor.initial
    fitted = batch.fit(whitened(arcs, x), x, FREE, SCALE, rest=1e-12)
    parts = [whitened(build_problem(one, sensor, catalogue).arcs, x) for one in sets]
    H = np.concatenate([whitened_rows(part, fitted.x, FREE, SCALE)[1] for part in parts])
    e = np.concatenate([whitened_plainly(part, fitted.x) for part in parts])
    step, *_ = np.linalg.lstsq(H, -e, rcond=None)
    sigma = np.sqrt(np.diag(np.linalg.inv(H.T @ H)))
    assert np.abs(step / sigma).max() < 1e-9
    np.testing.assert_allclose(batch.sigma_in_scale(fitted.A), sigma, rtol=1e-9)


def test_a_joint_set_in_pieces_gives_the_bits_of_one_in_memory(sensor, catalogue, tmp_path):
    sets = [a_pass(seed, frames=40 + seed) for seed in (7, 8)]
    files = []
    for k, one in enumerate(sets):
        (tmp_path / str(k)).mkdir()
        path, _ = written(one, tmp_path / str(k))
        files.append(NamedTelemetry(TelemetryFile(path, chunk_frames=16), f"pass {k}", str(k)))
    whole = calibrated(join_sets(files), sensor, catalogue)
    pieces = calibrated(join_sets(files, large_rows=0), sensor, catalogue)
    assert differences(whole.to_dict(), pieces.to_dict()) == []
    assert [one.sha256 for one in pieces.inputs.passes] == ["0", "1"]
    assert len(pieces.inputs.passes) == 2


def test_passes_are_taken_by_their_first_time_and_say_where_and_when_they_lay(sensor, catalogue):
    late, early = a_pass(1, day=30.0), replace(a_pass(2, day=0.0), temperature_c=np.full(960, 21.5))
    found = calibrated(together(late, early), sensor, catalogue)
    first, second = found.inputs.passes
    assert (first.name, second.name) == ("pass 1", "pass 0")
    assert first.start_utc == "2026-01-01T00:00:00.000000Z"
    assert second.start_utc.startswith("2026-01-31")
    assert (first.temperature_c, second.temperature_c) == (21.5, None)


def test_columns_that_a_pass_lacks_are_absent_in_it():
    bare = replace(a_pass(1), star_id=None, ra_rad=None, dec_rad=None)
    both = together(a_pass(2, day=0.0), bare).read()
    n = len(bare)
    assert np.isnan(both.ra_rad[-n:]).all()
    assert not both.star_id[-n:].any()
    assert np.isnat(both.time_utc[-n:]).all()
    assert not np.isnan(both.ra_rad[:-n]).any()


def test_frame_numbers_that_ascend_from_pass_to_pass_are_kept_and_rows_lead_back_to_each_file():
    one, other = a_pass(1), a_pass(2)
    joint = together(one, replace(other, frame=other.frame + 500, first_row=1))
    both = joint.read()
    first, second = joint.passes
    assert (second.first_frame, second.frame_offset) == (500, 0)
    row = both.first_row + len(one)  # of the second pass's first star
    assert row - second.row_offset == 1
    assert first.row_offset == 0


def test_a_pass_is_counted_once(sensor, catalogue):
    with pytest.raises(RefusedInputError, match=r"pass 2.*pass 0", check=has_code("same-centroids")):
        calibrated(together(a_pass(1), a_pass(2), a_pass(1)), sensor, catalogue)
    with pytest.raises(RefusedInputError, match=r"^b .* a again", check=has_code("same-file")):
        join_sets([NamedTelemetry(a_pass(1), "a", "ff"), NamedTelemetry(a_pass(2), "b", "ff")])


def frames_of(one, begin, end):
    """Some frames of a set, numbered from 0 as another download would have them."""
    inside = (one.frame >= begin) & (one.frame < end)
    named = [name for name in ARRAYS if getattr(one, name) is not None]
    cut = replace(one, **{name: getattr(one, name)[inside] for name in named})
    return replace(cut, frame=cut.frame - begin)


@pytest.mark.parametrize("large_rows", [1, 10**9], ids=["in pieces", "in memory"])
def test_passes_that_share_some_frames_are_refused_with_how_many(large_rows):
    """Twenty of sixty frames in two files would make every sigma 13 % too small."""
    whole = a_pass(5, day=0.0, frames=60)
    sets = together(frames_of(whole, 0, 40), a_pass(6, day=1.0), frames_of(whole, 20, 60), large_rows=large_rows)
    with pytest.raises(RefusedInputError, match="pass 2 contains the centroids of pass 0 in 20 of its frames: remove"):
        for _ in sets.chunks():
            pass
    apart = together(frames_of(whole, 0, 20), frames_of(whole, 20, 60))
    assert sum(len(part) for part in apart.chunks()) == len(whole)


def test_frames_in_whole_pixels_or_of_one_star_are_alike_by_chance():
    whole = a_pass(5, frames=20)
    rounded = replace(whole, row_px=np.rint(whole.row_px), col_px=np.rint(whole.col_px))
    single = replace(whole, frame=np.arange(len(whole)))
    assert len(hash_frames(whole)) == 20
    assert len(hash_frames(rounded)) == len(hash_frames(single)) == 0
    turned = np.argsort(-np.arange(len(whole)) + 1e6 * whole.frame, kind="stable")  # other order within each frame
    other = replace(whole, row_px=whole.row_px[turned], col_px=whole.col_px[turned], frame=whole.frame[turned])
    np.testing.assert_array_equal(hash_frames(other), hash_frames(whole))
