"""`boresight simulate`: telemetry whose truth is known, as files in the contract's form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import orjson

from boresight.cli.output import aligned, progress, refuse_standard_output, write_json
from boresight.errors import RefusedInputError
from boresight.settings import read_settings

BUILT_IN = tuple(f"st16-{number}" for number in range(1, 7))
VALIDATION_DELAY_H = 6


@click.command()
@click.argument("scenario")
@click.option("--out", "folder", type=click.Path(path_type=Path), required=True, help="Folder for the files.")
@click.option(
    "--frames", type=click.IntRange(1, 200_000), help="Frames of the calibration set, instead of the scenario's."
)
@click.option("--seed", type=click.IntRange(0), help="Seed of the noise, instead of the scenario's.")
@click.option("--format", "suffix", type=click.Choice(["csv", "parquet"]), default="csv", show_default=True)
def simulate(scenario: str, folder: Path, frames: int | None, seed: int | None, suffix: str) -> None:
    """Simulate SCENARIO: st16-1 to st16-6, or a scenario file (JSON).

    Writes sensor.json, the calibration and the validation set, scenario.json and truth.json.
    """
    refuse_standard_output(folder, "A folder of files")
    with progress("loading the star catalogue") as report:
        calibration, validation = _scenarios(scenario, frames, seed)
        rows = _write(folder, {"calibration": calibration, "validation": validation}, suffix, report)
    click.echo(aligned([("file", "frames", "stars"), *rows]))


def _scenarios(name: str, frames: int | None, seed: int | None) -> tuple[Any, Any]:
    """Read the calibration scenario and the validation scenario that goes with it."""
    from boresight.simulation.scenes import calibration_scenario, parse_scenario, validation_scenario

    if name in BUILT_IN:
        number = BUILT_IN.index(name) + 1
        pair = calibration_scenario(number), validation_scenario(number)
    else:
        calibration = parse_scenario(_read(Path(name)))
        pair = calibration, _later(calibration)
    if frames is not None:
        pair = replace(pair[0], frames=frames), pair[1]
    if seed is not None:
        pair = replace(pair[0], seed=seed), replace(pair[1], seed=seed + 1)
    return pair


def _later(calibration: Any) -> Any:
    """Repeat a scenario hours later with other noise, for a set that took no part in the calibration."""
    import numpy as np

    start = calibration.orbit.start_utc + np.timedelta64(VALIDATION_DELAY_H, "h")
    return replace(calibration, orbit=replace(calibration.orbit, start_utc=start), seed=calibration.seed + 1)


def _read(path: Path) -> Any:
    try:
        return orjson.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise RefusedInputError(f"{path} is neither a file nor a built-in scenario ({', '.join(BUILT_IN)}).") from error
    except orjson.JSONDecodeError as error:
        raise RefusedInputError(f"{path} is no JSON: {error}.") from error
    except OSError as error:
        raise RefusedInputError(f"{path} cannot be read: {error.strerror}.") from error


def _write(folder: Path, scenarios: dict[str, Any], suffix: str, report: Any) -> list[tuple[str, str, str]]:
    """Simulate and write every file; return a row a telemetry file."""
    import numpy as np

    from boresight.simulation.scenes import scenario_document, simulate
    from boresight.sky.catalogue import load_catalogue
    from boresight.telemetry.read.readers import write_csv, write_parquet

    catalogue = load_catalogue(read_settings().catalogue_folder)
    _make(folder)
    rows = []
    for purpose, scenario in scenarios.items():
        report(f"simulating the {purpose} set, {scenario.frames:,} frames")
        telemetry = simulate(scenario, np.random.default_rng(scenario.seed), catalogue)
        path = folder / f"{purpose}.{suffix}"
        (write_csv if suffix == "csv" else write_parquet)(telemetry, path)
        rows.append((str(path), f"{len(np.unique(telemetry.frame)):,}", f"{len(telemetry):,}"))
    document = scenario_document(scenarios["calibration"])
    write_json(document["sensor"], str(folder / "sensor.json"))
    write_json(document["truth"], str(folder / "truth.json"))
    write_json(document, str(folder / "scenario.json"))
    return rows


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedInputError(
            f"The folder {folder} cannot be made: {error.strerror}; choose another place."
        ) from error
