"""Commands on a server: `--server URL`, with an API key from the environment, because other users can see a command line."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import click

from boresight.errors import UnauthenticatedError

if TYPE_CHECKING:
    from boresight.library.client import Client
    from boresight.library.remote import ParameterSet

#: The environment variable with the key.
API_KEY = "BORESIGHT_API_KEY"

_HELP = f"Do it on this server, with the API key in {API_KEY}."
server_option = click.option("--server", "server_url", metavar="URL", help=_HELP)
required_server_option = click.option("--server", "server_url", metavar="URL", required=True, help=_HELP)


def first_message(url: str | None) -> str:
    """Say what a command begins with."""
    return "reading the telemetry" if url is None else "contacting the server"


def open_client(url: str) -> Client:
    """Return a client of a server."""
    from boresight.library.client import Client

    key = os.environ.get(API_KEY)
    if not key:
        raise UnauthenticatedError(
            f"A server needs an API key: create one on the server's page Users and keys and set {API_KEY}."
        )
    return Client(url, key)


def find_set(server: Client, named: str) -> ParameterSet:
    """Read a parameter set of a server by its name, or its number."""
    return server.parameter_set(int(named) if named.isdecimal() else named)
