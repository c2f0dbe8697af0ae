"""Sets for the tests of calibration: directions of their own, judged by trust, names taken away, in memory and in a file."""

from dataclasses import dataclass, replace
from unittest import mock

import numpy as np
import pyarrow.parquet as arrow_parquet
from scipy.spatial.transform import Rotation

from boresight.calibration import result
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import to_plain
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.matching.rematch import Matches, Rematcher, ground_covariance
from boresight.calibration.matching.verification import NONE, Verification
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.result import describe_estimate
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.calibration.trust import TrustReport, judge_trust
from boresight.calibration.trust.fitted_set import FittedSet, fit_best
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.writing import contract_table
from tests.estimation.fields import COLUMNS, GROUND, NOISE_PX, PITCH, ROWS, SCALE, TRUTH


@dataclass(frozen=True)
class Case:
    problem: Problem
    parameters: Parameters
    settings: CalibrationSettings
    estimate: Estimate
    telemetry: Telemetry
    catalogue: Catalogue

    @property
    def ground(self) -> FittedSet:
        return fit_best(**vars(self))

    @property
    def report(self) -> TrustReport:
        return judge_trust(**vars(self))

    @property
    def trust(self) -> dict:
        return to_plain(self.report.trust)


def case(telemetry, sensor, catalogue, **settings):
    chosen = CalibrationSettings(**{"match": "given", **settings})
    with (
        mock.patch.object(result, "describe_estimate", wraps=result.describe_estimate) as written,
        mock.patch(
            "boresight.calibration.calibrate.evaluate_result", lambda found, *_: found
        ),  # judged here, part by part
    ):
        calibrate(telemetry, sensor, catalogue, chosen)
    return Case(*written.call_args.args[:4], telemetry, catalogue)


def unverified():
    """Let given stars stand whatever they are: for what is said of wrong ones that nothing removed."""
    return mock.patch.object(Verification, "verify", return_value=NONE)


def measured(rng, s_i, place, noise_px, frames, exposures=1):
    """A file's rows: the stars of `exposures` a frame at (row, column) with noise, under directions of their own."""
    n, stars = len(s_i), len(s_i) // (frames * exposures)
    return Telemetry(
        frame=np.repeat(np.arange(frames), exposures * stars),
        exposure=np.tile(np.repeat(np.arange(exposures), stars), frames),
        row_px=place[0] + noise_px * rng.normal(size=n),
        col_px=place[1] + noise_px * rng.normal(size=n),
        star_id=np.arange(1, n + 1),
        ra_rad=np.arctan2(s_i[:, 1], s_i[:, 0]),
        dec_rad=np.arcsin(s_i[:, 2]),
    )


def st16():
    return Sensor(
        name="ST16-T", rows=ROWS, columns=COLUMNS, pixel_pitch_m=PITCH, camera_model="inverted_wang", parity=1,
        centroid_sigma_px=NOISE_PX, initial=GROUND.copy(), typical_sigma=SCALE.copy(), free=INVERTED_WANG.parameter_names,
    )  # fmt: skip


#: Pixels of the focal length that spread a lens's field so far that all its terms are seen; the others have that of the ST-16.
FOCAL_PX = {"kannala_brandt": 1800.0, "brown_conrady": 4500.0}


def lens(model, rng, focal_px=None):
    """A sensor of a camera model, without tilt and distortion, and a lens that is as far from it as such lenses are."""
    camera = CAMERA_MODELS[model]
    sigma = np.array(camera.default_typical_sigma)
    x = camera.plain(focal_px or FOCAL_PX.get(model, 7300.0), ROWS / 2, COLUMNS / 2, PITCH)
    sensor = replace(
        st16(), camera_model=model, centroid_sigma_px=0.1, initial=x, typical_sigma=sigma, free=camera.parameter_names
    )
    return sensor, x + rng.normal(size=len(x)) * sigma


def field(seed, frames=40, stars=12, exposures=2, parity=1, noise_px=NOISE_PX, camera=INVERTED_WANG, truth=TRUTH):
    rng = np.random.default_rng(seed)
    n = frames * exposures * stars
    row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
    s_d = camera.directions(truth, row, col, PITCH) * np.array([1.0, parity, 1.0])
    turns = Rotation.random(frames * exposures, rng=rng).as_matrix()
    s_i = np.einsum("eij,eni->enj", turns, s_d.reshape(-1, stars, 3)).reshape(n, 3)
    return measured(rng, s_i, (row, col), noise_px, frames, exposures)


def lens_case(catalogue, model, seed, share=1.0, focal_px=None, **settings):
    """A set of a lens that is `share` of its typical sigmas from a plain one, and the truth."""
    sensor, truth = lens(model, np.random.default_rng([5, seed]), focal_px)
    truth = sensor.initial + share * (truth - sensor.initial)
    stars = field([6, seed], frames=30, noise_px=sensor.centroid_sigma_px, camera=CAMERA_MODELS[model], truth=truth)
    stars = replace(stars, time_utc=np.datetime64("2026-03-01", "us") + 60_000_000 * stars.frame)
    return case(stars, sensor, catalogue, **settings), truth


def described(case):
    return describe_estimate(case.problem, case.parameters, case.settings, case.estimate, {})


def simulated(catalogue, number=1, frames=120, seed=0, changes=None, sky=None, **settings):
    scenario = replace(calibration_scenario(number, frames), **(changes or {}))
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    return case(telemetry, st16_sensor(number), catalogue if sky is None else sky, **settings)


SENSORS = (1, 2, 3, 4, 5, 6)


@dataclass(frozen=True)
class Sky:
    telemetry: Telemetry
    sensor: Sensor
    catalogue: object
    x: np.ndarray
    P: np.ndarray

    @property
    def true(self):
        return self.telemetry.star_id

    def blanked(self, share, seed=7):
        gone = np.random.default_rng(seed).random(len(self.true)) < share
        return replace(self.telemetry, star_id=np.where(gone, 0, self.true), quaternion=None)

    def match(self, telemetry, folder=None, **settings) -> Matches:
        chosen = CalibrationSettings(**settings)
        return Rematcher(telemetry, self.sensor, self.catalogue, chosen, folder)(self.x, self.P)


def sky(catalogue, number=1, frames=40, seed=0, start="ground", **changes):
    scenario = replace(
        calibration_scenario(number, frames), **{"false_stars": 1.0, "blanked_share": 0.0, "seed": seed, **changes}
    )
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    sensor = st16_sensor(number)
    if start == "ground":
        return Sky(telemetry, sensor, catalogue, sensor.initial, ground_covariance(sensor, 10.0))
    return Sky(telemetry, sensor, catalogue, st16_truth(number), np.diag((0.1 * sensor.typical_sigma) ** 2))


class Score:
    sought = back = matched = wrong = frames = solved = 0

    def count(self, matches, telemetry, true):
        sought = (true > 0) & (telemetry.star_id != true)
        self.sought += sought.sum()
        self.back += (sought & (matches.star_id == true)).sum()
        self.matched += (matches.star_id > 0).sum()
        self.wrong += ((matches.star_id > 0) & (matches.star_id != true)).sum()
        first = np.unique(matches.frame, return_index=True)[1]
        self.frames += len(first)
        self.solved += np.logical_or.reduceat(matches.valid, first).sum()

    @property
    def recovered(self):
        return self.back / self.sought

    @property
    def wrong_share(self):
        return self.wrong / self.matched


#: Of the document, what depends on the clock.
TIMED = ("timing_s",)


def written(telemetry, folder, rows_a_group=100):
    path = write_in_groups(telemetry, folder, rows_a_group)
    return path, read_telemetry(path)


def write_in_groups(telemetry, folder, rows_a_group):
    path = folder / "set.parquet"
    arrow_parquet.write_table(contract_table(telemetry), path, row_group_size=rows_a_group)
    return path


def streamed(path, sensor, catalogue, chunk_frames, validation=None, **choices):
    file = TelemetryFile(path, large_rows=0, chunk_frames=chunk_frames)
    choices = {"scratch_folder": path.parent, **choices}
    return calibrate(file, sensor, catalogue, *_settings(choices), validation=validation, **choices).to_dict()


def in_memory(telemetry, sensor, catalogue, validation=None, **choices):
    return calibrate(telemetry, sensor, catalogue, *_settings(choices), validation=validation, **choices).to_dict()


def _settings(choices):
    names = set(CalibrationSettings.__dataclass_fields__) & set(choices)
    return [CalibrationSettings(**{name: choices.pop(name) for name in names})]


def differences(one, other, path=""):
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            return [f"{path}: {sorted(one.keys() ^ other.keys())}"]
        pairs = [(key, one[key], other[key]) for key in one if key not in TIMED]
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = [(place, *pair) for place, pair in enumerate(zip(one, other, strict=True))]
    else:
        return [] if one == other else [f"{path}: {str(one)[:60]} != {str(other)[:60]}"]
    return [found for key, mine, theirs in pairs for found in differences(mine, theirs, f"{path}.{key}")]


def same_in_pieces(path, whole, sensor, catalogue, chunk_frames, executor=None, **choices):
    """The document of a set in memory, once that of its file in pieces is found to be the same."""
    document = in_memory(whole, sensor, catalogue, **choices)
    elsewhere = {} if executor is None else {"executor": executor}
    assert differences(document, streamed(path, sensor, catalogue, chunk_frames, **choices, **elsewhere)) == []
    return document
