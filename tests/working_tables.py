"""A working table of one part."""

from pathlib import Path

from boresight.telemetry.schema import Telemetry
from boresight.telemetry.working_table import WorkingTableParts


def write_working_table(telemetry: Telemetry, path: Path) -> None:
    """Write a set as one part."""
    with WorkingTableParts(path) as parts:
        parts.write(telemetry)
