"""`boresight worker`, `scheduler` and `warm`: a cluster's machines, and compiling ahead of the first run."""

from __future__ import annotations

import os
from pathlib import Path

import click

from boresight.cli.serve import data_option, read_serve_settings
from boresight.errors import BoresightError, RefusedInputError
from boresight.library.progress import progress
from boresight.settings import Settings, private_files, read_settings, use_kernel_folder

GB = 1_000_000_000


@click.command()
@click.option(
    "--scheduler", help="Address of the scheduler, instead of the setting: tls://host:port or tcp://host:port."
)
@click.option(
    "--processes",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Number of worker processes; one per core is recommended.",
)
@click.option(
    "--memory-gb",
    type=click.FloatRange(min=0, min_open=True),
    help="Memory limit per process; a process that exceeds it is restarted.  [default: one core's share of 80 % of the machine's "
    "memory]",
)
@data_option
def worker(scheduler: str | None, processes: int, memory_gb: float | None, data: Path | None) -> None:
    """Compute for a server on another machine, until Ctrl-C or SIGTERM.

    The server's data folder must be mounted here under the same path. A worker that loses its scheduler waits until one
    answers at that address, then joins again.
    """
    settings = _settings(scheduler, data)
    use_kernel_folder(settings)
    from boresight.workers.service import run_workers

    with private_files(settings):
        run_workers(settings, processes, None if memory_gb is None else int(memory_gb * GB), _say)


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on: one of a private network.")
@click.option("--port", type=click.IntRange(1, 65535), default=8786, show_default=True, help="Port to listen on.")
def scheduler(host: str, port: int) -> None:
    """Connect a server with its workers, until Ctrl-C or SIGTERM.

    With certificates (BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE) its address begins with tls://. Without them, anyone
    who can reach the port can run programs on the workers and the server, so it listens on this machine only, unless
    BORESIGHT_CLUSTER_NETWORK_CLOSED=1. If BORESIGHT_SCHEDULER is set here too, it must match.
    """
    settings = read_settings()
    from boresight.workers.service import run_scheduler

    try:
        run_scheduler(settings, host, port, _say)
    except OSError as error:
        raise RefusedInputError(
            f"{host}:{port} is in use or not available ({error.strerror or error}): stop the program that uses it, "
            "or choose another with --port.",
            code="port-in-use",
        ) from error


def _settings(address: str | None, data: Path | None) -> Settings:
    """Read the settings, overridden by the command line; refuse to run without a scheduler's address."""
    given = {name: str(value) for name, value in (("SCHEDULER", address), ("DATA_FOLDER", data)) if value is not None}
    settings = read_settings({**os.environ, **{f"BORESIGHT_{name}": value for name, value in given.items()}})
    if not settings.scheduler:
        raise RefusedInputError(
            "There is no scheduler to work for: give --scheduler tcp://host:port.", code="no-scheduler"
        )
    return settings


def _say(line: str) -> None:
    click.echo(line, err=True)


@click.command()
@data_option
@click.option(
    "--camera", "cameras", multiple=True, metavar="MODEL",
    help="Camera model to compile for, or all; can be repeated. Others are compiled when they are first used. "
    " [default: those of the registered sensors]",
)  # fmt: skip
def warm(data: Path | None, cameras: tuple[str, ...]) -> None:
    """Compile the kernels and trim the star catalogue, once per installation.

    Otherwise the first run does this, which takes about ten seconds on two cores. Kernels are stored in NUMBA_CACHE_DIR if
    set, otherwise in the virtual environment created by `make`, otherwise in the data folder; they are valid for this version
    of Boresight on this kind of processor.
    """
    settings = read_serve_settings(data)
    use_kernel_folder(settings)
    with progress("compiling the kernels"):
        from boresight.cameras import CAMERA_MODELS
        from boresight.workers.tasks import warm as compile_kernels

        if unknown := set(cameras) - {*CAMERA_MODELS, "all"}:
            raise RefusedInputError(
                f"There is no camera model {', '.join(sorted(unknown))}: choose from {', '.join([*CAMERA_MODELS, 'all'])}."
            )
        wanted = tuple(CAMERA_MODELS) if "all" in cameras else cameras or _registered_cameras(settings)
        compile_kernels(settings.catalogue_folder, wanted)
    click.echo(f"Kernels are compiled, in {os.environ.get('NUMBA_CACHE_DIR') or 'the cache folder of Numba'}.")


def _registered_cameras(settings: Settings) -> tuple[str, ...]:
    """Return the camera models of the registered sensors; none where there is no store yet, or it cannot be read."""
    import sqlalchemy as sa

    from boresight.console.fleet.queries import list_camera_models
    from boresight.platform.db.sessions import open_engine, open_reading

    file = sa.make_url(settings.database_url).database
    if settings.database_url.startswith("sqlite") and not Path(file or "").is_file():
        return ()
    engine = open_engine(settings.database_url)
    try:
        with open_reading(engine) as session:
            return tuple(list_camera_models(session))
    except (BoresightError, sa.exc.SQLAlchemyError):
        return ()
    finally:
        engine.dispose()
