"""Writing telemetry: as a table of the contract's columns, and tables as Parquet, CSV and JSON Lines."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv

from boresight.arrays import FloatArray, IntArray
from boresight.telemetry.schema import UNMATCHED, Telemetry

#: Rows that are compressed together: few enough that one frame of a large set is read in a moment (`telemetry.read.frames`).
ROW_GROUP = 65_536


def write_parquet(telemetry: Telemetry, path: Path) -> None:
    """Write telemetry as Parquet, compressed with zstd; absent values are null."""
    with path.open("wb") as stream:
        write_table(contract_table(telemetry), stream, ".parquet")


def write_csv(telemetry: Telemetry, path: Path) -> None:
    """Write telemetry as CSV with every digit; absent values are empty cells, times end in Z."""
    with path.open("wb") as stream:
        write_table(contract_table(telemetry), stream, ".csv")


def write_with_stars(table: pa.Table, star_id: IntArray, stream: IO[bytes], suffix: str) -> None:
    """Write a telemetry file's columns again with other stars, everything else as it stands.

    `star_id`: (n_rows,) Hipparcos numbers, 0 = unmatched, which is written as an absent cell.
    """
    cells = pa.array(star_id, mask=star_id == UNMATCHED)
    if "star_id" in table.column_names:
        table = table.set_column(table.column_names.index("star_id"), "star_id", cells)
    else:
        table = table.append_column("star_id", cells)
    write_table(table, stream, suffix)


def write_table(table: pa.Table, stream: IO[bytes], suffix: str) -> None:
    """Write a table of telemetry as its suffix says, CSV where it says nothing."""
    match suffix:
        case ".parquet":
            import pyarrow.parquet as arrow_parquet  # noqa: PLC0415 - with every file system that Arrow knows, 40 ms

            arrow_parquet.write_table(table, stream, compression="zstd", row_group_size=ROW_GROUP)
        case ".jsonl" | ".ndjson":
            _write_json_lines(_with_time_texts(table), stream)
        case _:
            arrow_csv.write_csv(_with_time_texts(table), stream)


def _write_json_lines(table: pa.Table, stream: IO[bytes]) -> None:
    for batch in table.to_batches():
        stream.writelines(orjson.dumps(row, option=orjson.OPT_APPEND_NEWLINE, default=str) for row in batch.to_pylist())


def _with_time_texts(table: pa.Table) -> pa.Table:
    """Return a table whose times are ISO 8601 text that ends in Z."""
    for place, field in enumerate(table.schema):
        if pa.types.is_timestamp(field.type):
            stamps = pc.strftime(table[field.name], format="%Y-%m-%dT%H:%M:%SZ")
            table = table.set_column(place, field.name, stamps)
    return table


def contract_table(telemetry: Telemetry) -> pa.Table:
    """Return telemetry as a table of the contract's columns, absent columns left out."""
    columns: dict[str, pa.Array] = {
        "frame": pa.array(telemetry.frame),
        "exposure": pa.array(telemetry.exposure),
        "row_px": pa.array(telemetry.row_px),
        "col_px": pa.array(telemetry.col_px),
    }
    if telemetry.time_utc is not None:
        columns["time_utc"] = pa.array(telemetry.time_utc, pa.timestamp("us", tz="UTC"))
    if telemetry.star_id is not None:
        columns["star_id"] = pa.array(telemetry.star_id, mask=telemetry.star_id == UNMATCHED)
    for name, values in _optional_numbers(telemetry).items():
        if values is not None:
            columns[name] = pa.array(values, mask=np.isnan(values))
    return pa.table(columns | {name: _compact(cells) for name, cells in telemetry.unknown.items()})


def _compact(cells: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return texts with dictionaries of those texts alone that are used: a slice brings the dictionary of all it was cut from."""
    if not pa.types.is_dictionary(cells.type):
        return cells
    chunks = []
    for chunk in cells.chunks:
        used, place = np.unique(chunk.indices.to_numpy(), return_inverse=True)
        chunks.append(pa.DictionaryArray.from_arrays(place.astype(np.int32), chunk.dictionary.take(pa.array(used))))
    return pa.chunked_array(chunks, cells.type)


def _optional_numbers(telemetry: Telemetry) -> dict[str, FloatArray | None]:
    """Return the optional float columns in the contract's units."""
    quaternion, velocity = telemetry.quaternion, telemetry.velocity_m_s
    return {
        "magnitude": telemetry.magnitude,
        "sigma_px": telemetry.sigma_px,
        "ra_deg": None if telemetry.ra_rad is None else np.degrees(telemetry.ra_rad),
        "dec_deg": None if telemetry.dec_rad is None else np.degrees(telemetry.dec_rad),
        **{f"q_{axis}": None if quaternion is None else quaternion[:, k] for k, axis in enumerate("xyzw")},
        **{f"v{axis}_km_s": None if velocity is None else velocity[:, k] / 1e3 for k, axis in enumerate("xyz")},
        "temperature_c": telemetry.temperature_c,
        "psf_sigma_px": telemetry.psf_sigma_px,
    }
