"""What a refusal looks like in a terminal: one line, then the first faults, a line each."""

from __future__ import annotations

from typing import Any

import click

from boresight.disks import storage_error
from boresight.errors import BoresightError, RefusedInputError

FAULTS_SHOWN = 10
REFUSED, INTERRUPTED = 1, 130


class RefusingGroup(click.Group):
    """A command group that turns errors into lines and exit codes."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; a refusal becomes exit code 1, Ctrl-C 130."""
        try:
            return super().invoke(ctx)
        except BoresightError as error:
            _print_refusal(error)
            ctx.exit(REFUSED)
        except KeyboardInterrupt:
            click.echo("boresight: stopped.", err=True)
            ctx.exit(INTERRUPTED)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except Exception as error:
            of_disk = storage_error(error) if isinstance(error, OSError) else None
            if of_disk is not None:
                _print_refusal(of_disk)
                ctx.exit(REFUSED)
            if ctx.params.get("debug"):
                raise
            sentence = (
                f"unexpected {type(error).__name__}: {error}. Run it again as `boresight --debug ...` to see where."
            )
            click.echo(f"boresight: {sentence}", err=True)
            ctx.exit(REFUSED)


def _print_refusal(error: BoresightError) -> None:
    """Print the sentence, then the places it speaks of."""
    click.echo(f"boresight: {error}", err=True)
    faults = error.faults if isinstance(error, RefusedInputError) else ()
    if len(faults) == 1:  # the sentence has said it
        return
    for fault in faults[:FAULTS_SHOWN]:
        click.echo(f"  {fault}", err=True)
    if len(faults) > FAULTS_SHOWN:
        click.echo(f"  and {len(faults) - FAULTS_SHOWN} more.", err=True)
