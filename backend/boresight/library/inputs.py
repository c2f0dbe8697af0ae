"""What the library takes for telemetry, sensors and parameters: files, tables, arrays and the library's own results.

A table in memory is read by the same checks as a file. Its rows are counted from 0, as `iloc` and array indices count them.
Telemetry tables come through the Arrow PyCapsule interface (pandas from 2.2, Polars, PyArrow, DuckDB), or through the older data
frame interchange protocol where an object has only that: pandas deprecates it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Calibration, parse_foreign_calibration
from boresight.calibration.joint.passes import JointTelemetry, NamedTelemetry, join_sets
from boresight.calibration.joint.prior import PriorSource
from boresight.calibration.parameter_file import parse_parameters, read_document, read_reliable_parameters
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.disks import compute_digest
from boresight.errors import RefusedInputError
from boresight.telemetry.read.formats import FormFaults, Tables
from boresight.telemetry.read.limits import Limits
from boresight.telemetry.readers import iterate_chunks
from boresight.telemetry.schema import REQUIRED_COLUMNS, Telemetry, joined
from boresight.telemetry.sensors import Sensor, parse_sensor, read_sensor

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


#: Rows of tables in memory are counted as their indices are.
FIRST_ROW = 0
#: What pandas calls an index without a name when it hands a frame on.
UNNAMED_INDEX = "__index_level_0__"


@runtime_checkable
class ArrowTable(Protocol):
    """A table that hands its columns on by the Arrow PyCapsule interface."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Return an Arrow C stream of record batches."""


@runtime_checkable
class InterchangeFrame(Protocol):
    """A table that hands its columns on by the data frame interchange protocol."""

    def __dataframe__(self, nan_as_null: bool = False, allow_copy: bool = True) -> object:
        """Return the interchange object."""


class HoldsTelemetry(Protocol):
    """What a function of the library returned with telemetry in it: an imported file, a simulation."""

    @property
    def telemetry(self) -> Telemetry:
        """The telemetry set."""


#: A file; a table; a structured array, or arrays (n_rows,) by column name; or a telemetry set of the library.
TelemetrySource = (
    str
    | os.PathLike[str]
    | Telemetry
    | HoldsTelemetry
    | ArrowTable
    | InterchangeFrame
    | Mapping[str, "ArrayLike | Sequence[object]"]
    | np.ndarray[Any, Any]
)
#: One telemetry set, or several of one sensor.
TelemetrySources = TelemetrySource | list[TelemetrySource] | tuple[TelemetrySource, ...]
#: A sensor file, what such a file says, or a sensor of the library.
SensorSource = str | os.PathLike[str] | Mapping[str, Any] | Sensor
#: A calibration, its JSON, or an object of parameter names and values, as file or in memory.
ParameterSource = str | os.PathLike[str] | Mapping[str, Any] | Calibration


def as_path(source: Any, what: str) -> Path:
    """Return the path that a source is; `what`: the forms that a refusal says are taken."""
    if not isinstance(source, str | os.PathLike):
        raise RefusedInputError(f"{type(source).__name__} is not supported: give {what}.", code="other-form")
    return Path(source)


#: Forms that are taken, as refusals say them.
SENSOR_FORMS = "a sensor file, its content as a mapping, or a sensor object of this library"
PARAMETER_FORMS = "a calibration, its file or its JSON as a mapping, or an object of parameter names and values"
SCENARIO_FORMS = "the name of a built-in scenario, a scenario file, or its content as a mapping"


def open_telemetry(source: TelemetrySource, limits: Limits) -> Telemetry | TelemetryFile:
    """Open telemetry; a large file is left on the disk and read in pieces."""
    if isinstance(source, str | os.PathLike):
        return TelemetryFile(Path(source), limits=limits).opened()
    return read_in_memory(source, limits)


def open_passes(sources: TelemetrySources, limits: Limits) -> Telemetry | TelemetryFile | JointTelemetry:
    """Open telemetry, several sets as one; their files are left on the disk."""
    several = list_sources(sources)
    if len(several) == 1:
        return open_telemetry(several[0], limits)
    return join_sets([_open_pass(source, number, limits) for number, source in enumerate(several, 1)])


def list_sources(sources: TelemetrySources) -> list[TelemetrySource]:
    """Return the telemetry sets that are meant, one or several."""
    several = list(sources) if isinstance(sources, list | tuple) else [sources]
    if several and isinstance(sources, list | tuple) and all(map(_is_row, several)):
        raise RefusedInputError(
            "Telemetry was given as rows; give columns: a mapping of column names to arrays, or a DataFrame."
        )
    if not several:
        raise RefusedInputError("No telemetry was given: name at least one set.", code="no-telemetry")
    return several


def _is_row(source: Any) -> bool:
    """Whether it is a star's row and no set: a mapping of names to single numbers."""
    return isinstance(source, Mapping) and bool(source) and all(np.ndim(value) == 0 for value in source.values())


def _open_pass(source: TelemetrySource, number: int, limits: Limits) -> NamedTelemetry:
    """Open one of several sets."""
    if isinstance(source, str | os.PathLike):
        path = Path(source)
        return NamedTelemetry(TelemetryFile(path, limits=limits), path.name, compute_digest(path))
    return NamedTelemetry(read_in_memory(source, limits), f"set {number}")


def find_telemetry(source: Any) -> Telemetry | None:
    """Return the telemetry set that a source is or holds; None where it is a table or a file."""
    held = source if isinstance(source, Telemetry) else getattr(source, "telemetry", None)  # or a column of that name
    return held if isinstance(held, Telemetry) else None


def read_in_memory(source: TelemetrySource, limits: Limits) -> Telemetry:
    """Read telemetry from memory."""
    if (held := find_telemetry(source)) is not None:
        return held
    name, table = open_table(source)
    columns = tuple(table.column_names)
    tables = Tables(columns, FIRST_ROW, lambda: iter([table]), FormFaults(name))
    return joined(list(iterate_chunks(tables, name, max(table.num_rows, 1), limits)))


def iterate_telemetry(
    source: TelemetrySource, limits: Limits, read_chunks: Callable[..., Iterator[Telemetry]]
) -> Iterator[Telemetry]:
    """Read telemetry in parts of whole frames."""
    if isinstance(source, str | os.PathLike):
        return read_chunks(Path(source), limits=limits)
    return iter([read_in_memory(source, limits)])


def open_table(source: Any) -> tuple[str, pa.Table]:
    """Return a source's name for refusals, and its columns."""
    if isinstance(source, np.ndarray) and source.dtype.names:
        return "The structured array", _join_arrays({name: source[name] for name in source.dtype.names})
    if isinstance(source, Mapping):
        return "The telemetry", _join_arrays(source)
    if hasattr(source, "collect") and not isinstance(source, ArrowTable | InterchangeFrame):
        raise RefusedInputError(
            f"The {type(source).__name__} is a query that has not run: give what its `.collect()` returns."
        )
    names = source.column_names if isinstance(source, pa.Table) else list(getattr(source, "columns", ()))
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise RefusedInputError(f"The {type(source).__name__} has two columns {twice!r}: rename or drop one of them.")
    if isinstance(source, ArrowTable):
        name, table = f"The {type(source).__name__}", pa.table(source)
    elif isinstance(source, InterchangeFrame):
        from pyarrow.interchange import from_dataframe

        name, table = f"The {type(source).__name__}", from_dataframe(source)
    else:
        raise RefusedInputError(
            f"Telemetry cannot be read from {type(source).__name__}: give a path, a DataFrame, a mapping of columns to arrays, or "
            "telemetry of this library."
        )
    columns = {column: _make_plain(table[column]) for column in table.column_names if column != UNNAMED_INDEX}
    return name, pa.table(columns)


def _join_arrays(arrays: Mapping[str, Any]) -> pa.Table:
    """Make a table of arrays by column name."""
    columns: dict[str, pa.ChunkedArray] = {}
    rows: int | None = None
    for name, values in arrays.items():
        array = np.ma.filled(values, np.nan) if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
        rows = array.size if rows is None else rows
        if array.shape != (rows,):
            raise RefusedInputError(
                f"The telemetry: column {name} has the shape {array.shape}, expected ({rows},): give one number per star."
            )
        if array.dtype.kind == "M":
            array = array.astype("datetime64[us]")
        try:
            columns[str(name)] = _make_plain(pa.chunked_array([pa.array(array, from_pandas=True)]))
        except (pa.ArrowInvalid, pa.ArrowTypeError, pa.ArrowNotImplementedError) as error:
            raise RefusedInputError(
                f"The telemetry: column {name} contains {array.dtype}: give numbers or texts."
            ) from error
    if not columns:
        raise RefusedInputError(f"The telemetry has no columns: give at least {', '.join(REQUIRED_COLUMNS)}.")
    return pa.table(columns)


def _make_plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return a column as a file would hold it: no dictionaries, no views, and null in place of NaN."""
    if pa.types.is_dictionary(column.type):
        kind = _plain_type(column.type.value_type)
        chunks = [chunk.dictionary.cast(kind).take(chunk.indices) for chunk in column.chunks]
        column = pa.chunked_array(chunks, kind)
    column = column.cast(_plain_type(column.type))
    if pa.types.is_floating(column.type):
        import pyarrow.compute as pc

        column = pc.if_else(pc.is_nan(column), None, column)
    return column


def _plain_type(kind: pa.DataType) -> pa.DataType:
    if pa.types.is_string_view(kind):
        return pa.large_string()
    return pa.float32() if pa.types.is_float16(kind) else kind


def read_any_sensor(source: SensorSource) -> Sensor:
    """Read a sensor."""
    if isinstance(source, Sensor):
        return source
    if isinstance(source, Mapping):
        return parse_sensor(source)
    return read_sensor(as_path(source, SENSOR_FORMS))


def read_any_parameters(source: ParameterSource, sensor: Sensor) -> tuple[FloatArray, FloatArray | None]:
    """Read parameters and, where there is one, their covariance, as `parameter_file.read_parameters` does."""
    return parse_parameters(read_parameter_document(source), sensor, describe_source(source))


def read_camera_parameters(source: ParameterSource, sensor: Sensor) -> tuple[FloatArray, FloatArray | None]:
    """Read parameters with the covariance to decide by: a calibration's with misfit."""
    if isinstance(source, Calibration):
        return read_reliable_parameters(source, sensor, describe_source(source))
    document = read_parameter_document(source)
    misfit = document.get("misfit")
    if isinstance(misfit, Mapping) and isinstance(misfit.get("covariance"), Mapping):
        document = {**document, "covariance": misfit["covariance"]}
    return parse_parameters(document, sensor, describe_source(source))


def read_parameter_document(source: ParameterSource) -> Mapping[str, Any]:
    """Return the document of parameters."""
    if isinstance(source, Calibration):
        return source.to_dict()
    if isinstance(source, Mapping):
        return source
    return read_document(as_path(source, PARAMETER_FORMS))


def read_any_calibration(source: ParameterSource) -> Calibration:
    """Read a whole calibration."""
    if isinstance(source, Calibration):
        return source
    return parse_foreign_calibration(read_parameter_document(source), describe_source(source))


def read_prior(source: ParameterSource) -> PriorSource:
    """Read a calibration to start from."""
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    name = "The prior" if path is None else path.name
    return PriorSource(read_any_calibration(source), name, None if path is None else compute_digest(path))


def describe_source(source: ParameterSource) -> str:
    """Return the name of a source of parameters for refusals."""
    if isinstance(source, Calibration):
        return "The calibration"
    return "The object of parameters" if isinstance(source, Mapping) else Path(source).name
