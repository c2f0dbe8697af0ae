"""Tables as CSV files to download: null is empty, columns of unequal length end early."""

from __future__ import annotations

import csv
import io

from starlette.responses import Response

from boresight.api.media import CsvFile
from boresight.figures import Table


def csv_text(table: Table) -> str:
    """Write columns as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    length = max((len(column) for column in table.values()), default=0)
    for k in range(length):
        writer.writerow([column[k] if k < len(column) and column[k] is not None else "" for column in table.values()])
    return text.getvalue()


def csv_response(table: Table, file_name: str) -> Response:
    """Answer with a table as a file."""
    headers = {"Content-Disposition": f'attachment; filename="{file_name}"'}
    return CsvFile(csv_text(table), headers=headers)
