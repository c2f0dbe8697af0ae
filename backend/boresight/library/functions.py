"""The functions of the library: what the commands do, on files, tables and arrays, with typed answers.

Each prepares what a door prepares: the settings of the environment, the folder of compiled kernels, which is the same for command,
library, workers and server, the star catalogue, and the threads to compute on.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar, Unpack

from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.errors import RefusedInputError
from boresight.library.progress import Report, Wanted, reporting
from boresight.settings import Settings, read_settings, use_kernel_folder

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from boresight.calibration.options import Choices
    from boresight.library.choice import Choice
    from boresight.library.inputs import ParameterSource, SensorSource, TelemetrySource
    from boresight.library.results import Assessment, Calibration, Evaluation, Matches, Quality, Simulation
    from boresight.sky.catalogue import Catalogue
    from boresight.telemetry.schema import Telemetry
    from boresight.telemetry.sensors import Sensor

BUILT_IN = tuple(f"st16-{number}" for number in range(1, 7))
VALIDATION_DELAY_H = 6
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class _Prepared:
    """The settings, catalogue and threads of a function."""

    settings: Settings
    report: Report

    def load_catalogue(self) -> Catalogue:
        from boresight.sky.catalogue import load_catalogue

        self.report("loading the star catalogue", None)
        return load_catalogue(self.settings.catalogue_folder)


def use_kernels() -> None:
    """Point Numba to the folder of compiled kernels, also where the caller has loaded Numba before."""
    use_kernel_folder(read_settings())
    if "numba" in sys.modules and "boresight.kernels" not in sys.modules:
        sys.modules["numba"].config.reload_config()


def _on_kernels(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that it sets the folder of kernels before it loads anything that compiles."""

    @functools.wraps(function)
    def called(*arguments: P.args, **named: P.kwargs) -> T:
        use_kernels()
        return function(*arguments, **named)

    return called


@contextmanager
def _prepared(progress: Wanted, message: str) -> Iterator[_Prepared]:
    """Read the settings, and compute on the machine's threads."""
    from boresight.estimation.blocks import computing_on

    settings = read_settings()
    with reporting(progress, message) as report, computing_on(settings.computing_threads):
        yield _Prepared(settings, report)


def parse_choices(choices: Mapping[str, Any]) -> CalibrationSettings:
    """Read the choices of a calibration; names and numbers of a list may be one text with commas."""
    return CalibrationSettings.parse(
        {
            name: _split(name, value) if isinstance(value, str) else value
            for name, value in choices.items()
            if value is not None
        }
    )


def _split(name: str, text: str) -> Any:
    kind = OPTIONS[name].kind if name in OPTIONS else "word"
    if kind not in {"names", "wholes"}:
        return text
    parts = [part.strip() for part in text.split(",") if part.strip()]
    return [int(part) if part.isdecimal() else part for part in parts] if kind == "wholes" else parts


@_on_kernels
def calibrate(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    *,
    validate: TelemetrySource | None = None,
    progress: Wanted = None,
    **settings: Unpack[Choices],
) -> Calibration:
    """Estimate a sensor's camera parameters from the stars it saw.

    Parameters
    ----------
    telemetry
        A file (CSV, JSON Lines, Parquet), a DataFrame or Arrow table, a mapping of column names to arrays (n_rows,), or telemetry
        of this library. One row a star: `frame`, `exposure`, `row_px`, `col_px`, and what else the telemetry format names, in the
        units of the names: pixels with (0, 0) at the centre of the top-left pixel, degrees ICRS, quaternions ICRS to detector.
    sensor
        A sensor file, what one says, or a sensor of this library.
    validate
        Telemetry that takes no part, to check the result by.
    progress
        True shows progress, False nothing; a function is told (message, share). Left out, it is shown in terminals and notebooks.
    settings
        The choices of a calibration by name, as `method="sqrf", free="f_m,b2_per_m2"`; `help(boresight.calibrate)` lists them.

    Returns
    -------
    The calibration. A numeric failure is its `status` with `advice`, no exception.

    Raises
    ------
    RefusedInputError
        When something cannot be used: one sentence, with row and column where it has them.
    """
    from boresight.library.inputs import open_telemetry, read_any_sensor
    from boresight.library.results import Calibration

    chosen = parse_choices(settings)
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.calibrate import calibrate as estimate

        limits, folder = prepared.settings.telemetry_limits, prepared.settings.catalogue_folder
        stars, described = open_telemetry(telemetry, limits), read_any_sensor(sensor)
        validation = None if validate is None else open_telemetry(validate, limits)
        catalogue = prepared.load_catalogue()
        prepared.report("building arcs and loading the compiled loops", None)
        found = estimate(
            stars,
            described,
            catalogue,
            chosen,
            validation=validation,
            sha256s=_hash_files({"telemetry": telemetry, "sensor": sensor, "validation": validate}),
            report=None if progress is False else lambda step: prepared.report(step.message, step.fraction),
            cache_folder=folder,
        )
    return Calibration.of(found)


@_on_kernels
def choose(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    *,
    validate: TelemetrySource | None = None,
    progress: Wanted = None,
    **settings: Unpack[Choices],
) -> Choice:
    """Choose the least camera model that suffices for telemetry: every model and its terms, tested on the same stars.

    Parameters as `calibrate`; of its settings `match` and `minimum_stars` count. `validate` is what candidates are held out
    against; left out, frames of the telemetry are.
    """
    from boresight.library.choice import Choice
    from boresight.library.inputs import open_telemetry, read_any_sensor

    chosen = parse_choices(settings)
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.choice.choose import choose as find

        limits = prepared.settings.telemetry_limits
        stars, described = open_telemetry(telemetry, limits), read_any_sensor(sensor)
        validation = None if validate is None else open_telemetry(validate, limits)
        found = find(
            stars,
            described,
            prepared.load_catalogue(),
            chosen,
            validation=validation,
            report=prepared.report,
            cache_folder=prepared.settings.catalogue_folder,
        )
    return Choice.of(found)


@_on_kernels
def match(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    *,
    parameters: ParameterSource | None = None,
    leave_out_doubles: bool = False,
    flight: bool = False,
    progress: Wanted = None,
) -> Matches:
    """Match the stars of telemetry again.

    Parameters
    ----------
    telemetry, sensor, progress
        As `calibrate`.
    parameters
        A calibration, or parameters by name, to match with; the sensor's own where left out.
    leave_out_doubles
        Leave out double stars and stars with unreliable astrometry.
    flight
        Keep only what the simulated check of the flight code accepts.
    """
    from boresight.library.inputs import read_any_parameters, read_any_sensor
    from boresight.library.results import Matches, parse_report

    chosen = CalibrationSettings(match="rematch", leave_out_doubles=leave_out_doubles)
    with _prepared(progress, "reading the telemetry") as prepared:
        from boresight.calibration.corrections import put_right
        from boresight.calibration.matching.match_report import match_report, matched_stars
        from boresight.calibration.matching.matched_frames import apply_flight_check
        from boresight.calibration.matching.rematch import ground_covariance, rematch

        described = read_any_sensor(sensor)
        x, P = (described.initial, None) if parameters is None else read_any_parameters(parameters, described)
        stars, off, catalogue = read_set(telemetry, described, prepared)
        stars = put_right(stars, described, catalogue, x)
        prepared.report("matching the stars", None)
        P = ground_covariance(described, chosen.initial_sigma_scale) if P is None else P
        matches = rematch(stars, described, catalogue, x, P, chosen, prepared.settings.catalogue_folder)
        seen = apply_flight_check(stars, described, matches, x, chosen) if flight else None
        document = match_report(stars, described, matches, seen)
        document |= {"advice": document["advice"] + off.sentences(), "stars_off_detector": off.document()}
        matched = replace(stars, star_id=matched_stars(matches, seen)[0])
    found: Matches = parse_report(Matches, document, telemetry=matched)
    return found


@_on_kernels
def evaluate(
    telemetry: TelemetrySource,
    sensor: SensorSource,
    parameters: ParameterSource,
    *,
    against: ParameterSource | None = None,
    shadow: bool = False,
    progress: Wanted = None,
    **settings: Unpack[Choices],
) -> Evaluation:
    """Compare two parameter sets on telemetry: availability, matched stars, RMS on common pairs.

    Parameters
    ----------
    telemetry, sensor, progress
        As `calibrate`.
    parameters
        A calibration, or parameters by name: `final`.
    against
        What it is compared with: `initial`; the sensor's own parameters where left out.
    shadow
        Also list the frames that one of the two would lose.
    settings
        Of those of a calibration, `match` and `flight_tolerance_urad` count.
    """
    from boresight.calibration.calibration import StarsOffDetector, parse_part
    from boresight.library.inputs import read_any_parameters, read_any_sensor
    from boresight.library.results import Evaluation

    chosen = parse_choices(settings)
    with _prepared(progress, "reading the telemetry") as prepared:
        import numpy as np

        from boresight.calibration.corrections import put_right
        from boresight.calibration.evaluation import bootstrap
        from boresight.calibration.evaluation.evaluate import evaluate_matched_frames, shadow_view
        from boresight.calibration.matching.matched_frames import match_under_states

        described = read_any_sensor(sensor)
        states = [
            (described.initial, None) if against is None else read_any_parameters(against, described),
            read_any_parameters(parameters, described),
        ]
        stars, off, catalogue = read_set(telemetry, described, prepared)
        stars = put_right(stars, described, catalogue, states[-1][0])
        prepared.report("matching the stars under both parameter sets", None)
        folder = prepared.settings.catalogue_folder
        initial, final = match_under_states(stars, described, catalogue, states, chosen, folder)
        rng = np.random.default_rng(bootstrap.SEED)
        found = evaluate_matched_frames(stars, described, initial, final, chosen, rng)
        return Evaluation(
            **{item.name: getattr(found, item.name) for item in fields(found)},
            sensor=described.name,
            stars_off_detector=parse_part(StarsOffDetector, off.document(), RefusedInputError),
            advice=off.sentences(),
            shadow=shadow_view(stars, initial, final) if shadow else None,
        )


@_on_kernels
def check(telemetry: TelemetrySource, sensor: SensorSource, *, progress: Wanted = None) -> Quality:
    """Report on the quality of telemetry: counts, gaps, coverage, magnitudes, matches. Arguments as `calibrate`."""
    from boresight.library.inputs import iterate_telemetry, read_any_sensor
    from boresight.library.results import Finding, Quality, parse_report
    from boresight.telemetry.quality.report import QualityParts

    settings = read_settings()
    with reporting(progress, "reading the telemetry") as report:
        from boresight.telemetry.read.readers import read_chunks

        prepared = _Prepared(settings, report)
        parts = QualityParts(read_any_sensor(sensor), prepared.load_catalogue())
        for part in iterate_telemetry(telemetry, settings.telemetry_limits, read_chunks):
            parts.add(part)
            report(f"reading the telemetry, up to frame {part.frame[-1]}", None)
        document = parts.report()
    found: Quality = parse_report(Quality, document)
    return replace(found, findings=[Finding(**one) for one in document["findings"]])


@_on_kernels
def assess(
    calibration: ParameterSource,
    sensor: SensorSource,
    *,
    validate: TelemetrySource | None = None,
    against: ParameterSource | None = None,
    profile: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    progress: Wanted = None,
) -> Assessment:
    """Hold a calibration against limits and against the incumbent.

    Parameters
    ----------
    calibration
        A calibration of this library, its JSON or the file of it.
    sensor, progress
        As `calibrate`.
    validate
        Held-out telemetry; the calibration's own validation where left out.
    against
        The incumbent's parameters; the sensor's where left out.
    profile
        Gate profile, as file or what one says; the default limits where left out.
    """
    from boresight.calibration.calibration import to_plain
    from boresight.calibration.parameter_file import read_document
    from boresight.library.inputs import read_any_calibration, read_any_sensor, read_parameter_document
    from boresight.library.results import Assessment

    with _prepared(progress, "reading the calibration") as prepared:
        from boresight.verdicts.gates import assessment as gates
        from boresight.verdicts.gates import parse_profile

        described = read_any_sensor(sensor)
        limits = parse_profile(
            {}
            if profile is None
            else profile
            if isinstance(profile, Mapping)
            else read_document(Path(profile), "a gate profile")
        )
        candidate = read_any_calibration(calibration)
        incumbent = (
            gates.ground_set(described)
            if against is None
            else gates.as_set(read_parameter_document(against), described)
        )
        frames = None
        if validate is not None:
            stars, _, catalogue = read_set(validate, described, prepared)
            frames = stars, catalogue
        prepared.report("measuring and judging", None)
        report = gates.assess(candidate, described, incumbent, limits, frames)
    return Assessment(
        sensor=described.name,
        verdict=report.verdict,
        words=report.words,
        blocking=report.blocking,
        gates=report.gates,
        document={**to_plain(report), "sensor": described.name},
    )


@_on_kernels
def simulate(
    scenario: str | os.PathLike[str] | Mapping[str, Any] = "st16-1",
    *,
    frames: int | None = None,
    seed: int | None = None,
    progress: Wanted = None,
) -> Simulation:
    """Simulate telemetry whose truth is known.

    Parameters
    ----------
    scenario
        `st16-1` to `st16-6`, a scenario file, or what one says: at least its `sensor`.
    frames
        Frames of the calibration set, instead of the scenario's.
    seed
        Seed of the noise, instead of the scenario's.
    progress
        As `calibrate`.
    """
    import numpy as np

    from boresight.calibration.calibration import Values
    from boresight.library.results import Simulation
    from boresight.simulation import scenes

    calibration, validation = make_scenarios(scenario, frames, seed)
    with reporting(progress, "simulating") as report:
        catalogue = _Prepared(read_settings(), report).load_catalogue()
        sets = []
        for purpose, one in (("calibration", calibration), ("validation", validation)):
            report(f"simulating the {purpose} set, {one.frames:,} frames", None)
            sets.append(scenes.simulate(one, np.random.default_rng(one.seed), catalogue))
    document = scenes.scenario_document(calibration)
    return Simulation(
        sensor=calibration.sensor,
        telemetry=sets[0],
        validation=sets[1],
        truth=Values(document["truth"]),
        scenario=document,
    )


def make_scenarios(
    scenario: str | os.PathLike[str] | Mapping[str, Any], frames: int | None, seed: int | None
) -> tuple[Any, Any]:
    """Return the scenario of a calibration set, and that of the validation set that goes with it."""
    import numpy as np

    from boresight.simulation.scenes import calibration_scenario, parse_scenario, validation_scenario

    if scenario in BUILT_IN:
        number = BUILT_IN.index(str(scenario)) + 1
        first, second = calibration_scenario(number), validation_scenario(number)
    else:
        first = parse_scenario(scenario if isinstance(scenario, Mapping) else _read_scenario(Path(scenario)))
        start = first.orbit.start_utc + np.timedelta64(VALIDATION_DELAY_H, "h")
        second = replace(first, orbit=replace(first.orbit, start_utc=start), seed=first.seed + 1)
    if frames is not None:
        first = replace(first, frames=frames)
    if seed is not None:
        first, second = replace(first, seed=seed), replace(second, seed=seed + 1)
    return first, second


def _read_scenario(path: Path) -> Any:
    import orjson

    try:
        return orjson.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise RefusedInputError(f"{path} is neither a file nor a built-in scenario ({', '.join(BUILT_IN)}).") from error
    except orjson.JSONDecodeError as error:
        raise RefusedInputError(f"{path} is no JSON: {error}.") from error
    except OSError as error:
        raise RefusedInputError(f"{path} cannot be read: {error.strerror}.") from error


@_on_kernels
def load(source: str | os.PathLike[str] | Mapping[str, Any]) -> Calibration:
    """Read a calibration that was saved, by `Calibration.save`, `boresight calibrate --json` or a server."""
    from boresight.library.inputs import read_any_calibration
    from boresight.library.results import Calibration

    return Calibration.of(read_any_calibration(source))


@_on_kernels
def draw(
    source: ParameterSource | Mapping[str, ParameterSource],
    name: str,
    *,
    theme: Literal["light", "dark", "contrast"] = "light",
) -> go.Figure:
    """Draw a figure of a calibration, or of several over one another: {label: calibration}.

    Parameters
    ----------
    source
        A calibration, its JSON or the file of it; or several by label.
    name
        One of `Calibration.figures`.
    theme
        `light` is white paper, `dark` and `contrast` are the console's.
    """
    from boresight.figures.notebook import draw as draw_figure
    from boresight.library.inputs import read_any_calibration

    if isinstance(source, Mapping) and "schema" not in source:
        return draw_figure({label: read_any_calibration(one) for label, one in source.items()}, name, theme=theme)
    return draw_figure(read_any_calibration(source), name, theme=theme)


@_on_kernels
def read_telemetry(source: TelemetrySource) -> Telemetry:
    """Read telemetry into arrays, SI, held against the rules of the format. `source` as `calibrate` takes it."""
    from boresight.library.inputs import read_in_memory
    from boresight.telemetry.read import readers

    limits = read_settings().telemetry_limits
    if isinstance(source, str | os.PathLike):
        return readers.read_telemetry(Path(source), limits=limits)
    return read_in_memory(source, limits)


@_on_kernels
def read_sensor(source: SensorSource) -> Sensor:
    """Read a sensor: a file, or what one says."""
    from boresight.library.inputs import read_any_sensor

    return read_any_sensor(source)


def read_set(telemetry: TelemetrySource, sensor: Sensor, prepared: _Prepared) -> tuple[Telemetry, Any, Catalogue]:
    """Read a telemetry set, its detections outside the detector, and the catalogue for its directions."""
    from boresight.telemetry.quality.detector import check_against_sensor

    stars = read_telemetry(telemetry)
    off = check_against_sensor(stars, sensor)
    return stars, off, prepared.load_catalogue()


def _hash_files(sources: Mapping[str, Any]) -> dict[str, str]:
    """Return the content addresses of those inputs that are files."""
    addresses = {}
    for role, source in sources.items():
        if isinstance(source, str | os.PathLike):
            with Path(source).open("rb") as file:
                addresses[role] = hashlib.file_digest(file, "sha256").hexdigest()
    return addresses


def _with_settings(function: Callable[..., Any], names: tuple[str, ...]) -> None:
    """Show the settings of a calibration in a function's signature and help, where they are declared once."""
    signature = inspect.signature(function)
    shown = [parameter for parameter in signature.parameters.values() if parameter.kind is not parameter.VAR_KEYWORD]
    keyword = inspect.Parameter.KEYWORD_ONLY
    shown += [inspect.Parameter(name, keyword, default=OPTIONS[name].default) for name in names]
    function.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]  # what `help` looks at
    lines = "\n".join(f"    {name}\n        {OPTIONS[name].sentence} {OPTIONS[name].range}." for name in names)
    function.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\nSettings\n--------\n{inspect.cleandoc(lines)}\n"


_with_settings(calibrate, tuple(OPTIONS))
_with_settings(choose, ("match", "minimum_stars"))
_with_settings(evaluate, ("match", "flight_tolerance_urad"))
