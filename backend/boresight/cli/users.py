"""`boresight user`: people, for whom nobody is logged in yet to make them."""

from __future__ import annotations

import sys

import click

from boresight.errors import RefusedInputError
from boresight.settings import read_settings


@click.group()
def user() -> None:
    """Manage people who may log in."""


@user.command()
@click.argument("name")
@click.option("--role", "roles", multiple=True, required=True, help="analyst, approver, ...; repeat it for several.")
@click.option("--printed-name", required=True, help="As signatures show it.")
@click.option("--password-stdin", is_flag=True, help="Read the password from standard input instead of asking.")
def add(name: str, roles: tuple[str, ...], printed_name: str, *, password_stdin: bool) -> None:
    """Add the person with the log-in NAME.

    Roles: viewer, analyst (uploads, launches, submits), operator (promotes, records uplinks), approver (signs),
    administrator (people and keys; cannot sign).
    """
    password = _password(from_stdin=password_stdin)
    from boresight.services import users
    from boresight.services.actors import COMMAND_LINE
    from boresight.services.passwords import prepare
    from boresight.store.sessions import opened, writing

    prepared = prepare(password, name, printed_name)
    with opened(read_settings().database_url) as engine, writing(engine) as session:
        made = users.create_user(
            session, COMMAND_LINE, name=name, printed_name=printed_name, password=prepared, roles=roles
        )
        click.echo(f"Added {made.name} ({made.printed_name}): {', '.join(made.roles)}")


def _password(*, from_stdin: bool) -> str:
    if not from_stdin:
        return str(click.prompt("Password", hide_input=True, confirmation_prompt=True, err=True))
    password = sys.stdin.readline().rstrip("\r\n")
    if not password:
        raise RefusedInputError("Standard input holds no password: pipe one line to --password-stdin.")
    return password
