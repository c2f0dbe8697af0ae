"""The command line: one file a group of commands, registered here.

Exit codes: 0 done, 1 refused with one clear line, 2 wrong usage, 130 stopped by Ctrl-C. Results go to standard output,
everything else to standard error. Heavy libraries are imported inside the commands, so that help comes at once.
"""

from __future__ import annotations

import gc
import os

import click

import boresight
from boresight.cli.administration import certificates, migrate, retention, user, webhook
from boresight.cli.align import align
from boresight.cli.audit import audit
from boresight.cli.backups import backup, restore
from boresight.cli.calibrate import calibrate
from boresight.cli.choose import choose
from boresight.cli.convert import convert
from boresight.cli.diagnose import diagnose
from boresight.cli.evaluate import assess, check, evaluate, match, submit
from boresight.cli.extract import extract
from boresight.cli.importing import import_telemetry
from boresight.cli.mission_control import openc3, yamcs
from boresight.cli.output import RefusingGroup
from boresight.cli.plan import plan
from boresight.cli.report import report
from boresight.cli.reproduce import reproduce, simulate
from boresight.cli.schema import schema
from boresight.cli.sensor import sensor
from boresight.cli.serve import demo, serve
from boresight.cli.table import export, table
from boresight.cli.worker import scheduler, warm, worker

#: Objects made, less those freed, before Python looks for cycles in a command that ends soon.
GARBAGE_THRESHOLD = 1_000_000
#: Commands that go on until they are stopped.
LASTING = ("serve", "demo", "worker", "scheduler")


@click.group(cls=RefusingGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(boresight.__version__, prog_name="boresight")
@click.option("--debug", is_flag=True, help="Show the traceback of an unexpected error.")
def main(*, debug: bool) -> None:  # noqa: ARG001 - the group asks for it itself
    """Recalibrate star trackers on orbit from downlinked star centroids.

    Every setting is an environment variable BORESIGHT_<NAME>; the documentation lists them, under `/docs` of every console.
    """
    # threads of our own share the work out; OpenBLAS's beside them wait for one another, and round by how many they are
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # libraries make half a million objects that stay; looking for cycles among them took a tenth of a short command
    if click.get_current_context().invoked_subcommand not in LASTING:
        gc.set_threshold(GARBAGE_THRESHOLD)


for command in (
    calibrate,
    choose,
    extract,
    diagnose,
    match,
    evaluate,
    convert,
    assess,
    check,
    import_telemetry,
    yamcs,
    openc3,
    simulate,
    align,
    plan,
    report,
    schema,
    sensor,
    submit,
    export,
    table,
    reproduce,
    serve,
    demo,
    worker,
    scheduler,
    certificates,
    warm,
    migrate,
    backup,
    restore,
    retention,
    user,
    webhook,
    audit,
):
    main.add_command(command)
