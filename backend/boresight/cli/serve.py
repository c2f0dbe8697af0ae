"""`boresight serve` and `boresight demo`: the console, empty or with a simulated fleet."""

from __future__ import annotations

import gc
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import click

from boresight.errors import RefusedInputError
from boresight.platform.observability.logs import sayer
from boresight.settings import Settings, private_files, read_settings, use_kernel_folder

DEMO_FOLDER = ".demo"
DEMO_SETTINGS = {
    "BORESIGHT_WORKERS": "3",  # two are held for ten minutes by filters that are watched
    "BORESIGHT_SECOND_PERSON": "0",  # it has one administrator
    "BORESIGHT_SECOND_FACTOR": "off",  # its passwords are on the screen
}
POLL_S = 0.1
REST_S = 0.3  # between two steps of the demonstration, so that its visitor's pages come first

host_option = click.option("--host", help="Address to listen on, instead of the setting.")
port_option = click.option("--port", type=click.IntRange(1, 65535), help="Port to listen on, instead of the setting.")
data_option = click.option("--data", type=click.Path(path_type=Path), help="Data folder, instead of the setting.")


@click.command()
@host_option
@port_option
@data_option
def serve(host: str | None, port: int | None, data: Path | None) -> None:
    """Serve the console until Ctrl-C."""
    settings = read_serve_settings(data, host, port)
    _claim_port(settings)
    line = f"Boresight on {_address(settings)}, data in {settings.data_folder}. Stop it with Ctrl-C."
    _serve(settings, lambda: sayer(settings.log_format, click.echo)(line))


@click.command()
@host_option
@port_option
@data_option
def demo(host: str | None, port: int | None, data: Path | None) -> None:
    """Serve the console with a simulated fleet, which is created and calibrated while you watch.

    The data folder is .demo unless --data or BORESIGHT_DATA_FOLDER names another.
    """
    if data is None and not os.environ.get("BORESIGHT_DATA_FOLDER"):
        data = Path(DEMO_FOLDER)
    settings = replace(read_serve_settings(data, host, port, DEMO_SETTINGS), mode="SIM")
    watched = settings.watch_folder or str(settings.data_folder / "watched")
    settings = replace(settings, watch_folder=watched)
    _claim_port(settings)
    Path(watched).mkdir(mode=0o700, parents=True, exist_ok=True)
    threading.Thread(target=_populate, args=(settings,), name="boresight-demonstration", daemon=True).start()
    _serve(settings)


def read_serve_settings(
    data: Path | None, host: str | None = None, port: int | None = None, defaults: Mapping[str, str] | None = None
) -> Settings:
    """Read the settings, overridden by the command line; `defaults` are in place of their own."""
    given = {"HOST": host, "PORT": port, "DATA_FOLDER": data}
    named = {f"BORESIGHT_{name}": str(value) for name, value in given.items() if value is not None}
    return read_settings({**(defaults or {}), **os.environ, **named})


def _address(settings: Settings) -> str:
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    return f"http://{host}:{settings.port}"


def _claim_port(settings: Settings) -> None:
    """Refuse an address that cannot be listened on, before anything is started."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((settings.host, settings.port))
    except OSError as error:
        raise RefusedInputError(
            f"{settings.host}:{settings.port} is in use or not available ({error.strerror}): stop the program that uses it, "
            "or choose another with --port.",
            code="port-in-use",
        ) from error


def _serve(settings: Settings, on_open: Callable[[], None] | None = None) -> None:
    """Run the server; Ctrl-C and SIGTERM are its ordinary ends, with exit code 0."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # uvicorn raises it once more when all is closed
    use_kernel_folder(settings)
    gc.disable()  # until the server serves: nothing that is imported is garbage, and looking costs a sixth of the start
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_store
    from boresight.server import serve as run
    from boresight.workers.security import make_security

    with private_files(settings):
        make_security(settings)  # refuse now what the engine would only log
        with open_store(settings.database_url):
            pass  # likewise for the server's start
        if settings.blob_location.is_folder:  # an object store may come back while the server waits
            open_blobs(settings.blob_location).refuse_unusable()
        try:
            run(settings, on_open)
        except KeyboardInterrupt:
            click.echo("boresight: stopped.", err=True)


def _populate(settings: Settings) -> None:
    """Make the demonstration as soon as the server answers, so that its first page does not wait for it."""
    _wait_until_served(settings)
    from boresight.cli.demonstration import LOG_INS, continue_demonstration, create_demonstration
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_engine
    from boresight.sky.catalogue import load_catalogue

    click.echo(f"\n  Boresight demonstration: {_address(settings)}\n\n  Log in as")
    for person in LOG_INS:
        click.echo(f"    {person.name:<14} {person.password:<28} {person.printed_name}")
    click.echo(f"\n  Telemetry dropped into {settings.watch_folder}/<sensor> is ingested for ST16-3 and ST16-4.")
    click.echo("\n  The fleet is being created and calibrated now. Stop with Ctrl-C.\n")
    engine = open_engine(settings.database_url)
    try:
        catalogue, blobs = load_catalogue(settings.catalogue_folder), open_blobs(settings.blob_location)
        watched = max(0, settings.workers - 1)  # one is left to whoever visits
        create_demonstration(engine, blobs, catalogue, _say, watched)
        for _ in continue_demonstration(engine, blobs, catalogue, _say, settings.policy, settings.own_key):
            time.sleep(REST_S)
    except Exception as error:  # noqa: BLE001 - a thread's last words; the server goes on
        click.echo(f"boresight: the demonstration could not be completed: {error}", err=True)
    finally:
        engine.dispose()


def _say(step: str) -> None:
    click.echo(f"  {step}")


def _wait_until_served(settings: Settings) -> None:
    while True:
        try:
            with socket.create_connection((settings.host, settings.port), timeout=1):
                return
        except OSError:
            time.sleep(POLL_S)
