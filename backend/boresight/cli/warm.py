"""`boresight warm`: what the first run would wait for, done beforehand."""

from __future__ import annotations

import os
from pathlib import Path

import click

from boresight.cli.output import progress
from boresight.cli.serve import data_option, read_serve_settings
from boresight.settings import use_kernel_folder


@click.command()
@data_option
def warm(data: Path | None) -> None:
    """Compile the kernels and trim the star catalogue, once an installation.

    Without it the first run does so, a quarter of a minute on two cores. Kernels go where NUMBA_CACHE_DIR says, else
    where `make` compiles them in its virtual environment, else into the data folder; they hold for this version of
    Boresight on this kind of processor.
    """
    settings = read_serve_settings(data)
    use_kernel_folder(settings)
    with progress("compiling the kernels"):
        from boresight.workers.warm_up import warm as compile_kernels

        compile_kernels(settings.catalogue_folder)
    click.echo(f"Kernels are compiled, in {os.environ.get('NUMBA_CACHE_DIR') or 'the cache folder of Numba'}.")
