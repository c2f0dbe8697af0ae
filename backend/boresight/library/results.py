"""The results of the library: the typed calibration with tables and drawings, and the other results as dataclasses.

`boresight.calibration.calibration` has the tree of numbers and draws nothing. Here it gets text, tables and drawings.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, overload

from boresight.calibration import calibration as tree
from boresight.calibration.calibration import ShadowOfSet, StarsOffDetector, Values, to_plain
from boresight.disks import writing
from boresight.errors import RefusedInputError
from boresight.library import text
from boresight.library.text import Summary, summary_lines

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    import polars as pl
    import pyarrow as pa

    from boresight.calibration.proposal import Proposal
    from boresight.images.extraction import ExtractedImage
    from boresight.telemetry.new_sensor import Described
    from boresight.telemetry.schema import Telemetry
    from boresight.telemetry.sensors import Sensor
    from boresight.verdicts.gates import GateAnswer

#: Libraries that make a table of columns.
FrameKind = Literal["pandas", "polars", "pyarrow"]


def make_frame(columns: Mapping[str, Any] | pa.Table, kind: FrameKind | None) -> Any:
    """Make a DataFrame of columns with the given library, by default the first that is installed."""
    import pyarrow as pa

    kinds = get_args(FrameKind)
    if kind is None:
        kind = next(one for one in kinds if find_spec(one) is not None)
    elif kind not in kinds:
        raise RefusedInputError(f"There is no kind of frame {kind!r}: choose from {', '.join(kinds)}.")
    table = pa.table(columns)
    if kind == "pyarrow":
        return table
    try:
        library = import_module(str(kind))
    except ImportError as error:
        raise RefusedInputError(
            f"{kind} is not installed here: pip install {kind}, or use to_frame('pyarrow'), which is."
        ) from error
    return table.to_pandas() if kind == "pandas" else library.DataFrame(table)


class Tabular:
    """What has a table of numbers."""

    def _columns(self) -> Mapping[str, Any] | pa.Table:
        raise NotImplementedError

    @overload
    def to_frame(self, kind: Literal["pandas"]) -> pd.DataFrame: ...
    @overload
    def to_frame(self, kind: Literal["polars"]) -> pl.DataFrame: ...
    @overload
    def to_frame(self, kind: Literal["pyarrow"]) -> pa.Table: ...
    @overload
    def to_frame(self, kind: None = None) -> Any: ...
    def to_frame(self, kind: FrameKind | None = None) -> Any:
        """Return a DataFrame: of a calibration a row a parameter, SI; of telemetry its rows, with `star_id` as matched.

        `kind`: pandas, polars or pyarrow; if omitted, the first of them that is installed.
        """
        return make_frame(self._columns(), kind)


class Summarised:
    """An answer that shows itself as a summary: in words in a terminal, as a table in a notebook."""

    def _summarise(self) -> Summary:
        raise NotImplementedError

    def __repr__(self) -> str:
        return str(self._summarise())

    def _repr_html_(self) -> str:
        """Show it in a notebook."""
        from boresight.library.page import summary_html

        return summary_html(self._summarise())


@dataclass(frozen=True, kw_only=True, repr=False)
class Reported(Summarised):
    """An answer with a report."""

    document: dict[str, Any] = field(default_factory=dict, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the whole report as plain lists, numbers and None."""
        return self.document


@dataclass(frozen=True, kw_only=True, repr=False)
class NewTelemetry(Tabular, Reported):
    """Telemetry that was made, with a report."""

    telemetry: Telemetry = field(repr=False)

    def _columns(self) -> pa.Table:
        return tabulate(self.telemetry)

    def save(self, path: str | Path) -> None:
        """Write the telemetry, with `star_id` as matched, as CSV or Parquet by the name's ending."""
        with writing(path):
            save_telemetry(self.telemetry, Path(path))


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibration(Tabular, tree.Calibration):
    """A calibration: every number of its JSON as a typed member, with tables and drawings.

    `parameters`, `sigma`: by name, SI, as `parameters.f_m`. `covariance`: `names` and `matrix`; `numpy.asarray` makes an array.
    `advice`: sentences. `status`: `converged`, or why not.
    """

    @classmethod
    def of(cls, found: tree.Calibration) -> Calibration:
        """Make this class from a plain calibration."""
        return (
            found if isinstance(found, cls) else cls(**{item.name: getattr(found, item.name) for item in fields(found)})
        )

    def __repr__(self) -> str:
        return "\n".join(summary_lines(self))

    def _repr_html_(self) -> str:
        """Show it in a notebook."""
        from boresight.library.page import page_html

        return page_html(self)

    @property
    def figures(self) -> tuple[str, ...]:
        """The names of all figures."""
        from boresight.figures import FIGURES

        return tuple(FIGURES)

    def draw(self, name: str, *, theme: Literal["light", "dark", "contrast"] = "light") -> go.Figure:
        """Draw a figure; `figures` lists the names."""
        from boresight.figures.notebook import draw

        return draw(self, name, theme=theme)

    def table(self, name: str) -> dict[str, list[Any]]:
        """Return the numbers behind a figure as columns of one length, complete and in SI."""
        from boresight.figures.notebook import table

        return table(self, name)

    def _columns(self) -> Mapping[str, Any]:
        names = list(self.parameters)
        initial, final = ([values.get(name) for name in names] for values in (self.initial, self.parameters))
        change = [None if a is None or b is None else b - a for a, b in zip(initial, final, strict=True)]
        sigma = [self.sigma.get(name) for name in names]
        wider = [self.sigma_with_misfit.get(name, alone) for name, alone in zip(names, sigma, strict=True)]
        return {
            "parameter": names,
            "unit": [self.units.get(name, "") for name in names],
            "initial": initial,
            "final": final,
            "change": change,
            "sigma": sigma,
            "sigma_with_misfit": wider,
            "change_over_sigma": [d / s if d is not None and s else None for d, s in zip(change, wider, strict=True)],
            "typical_sigma": [self.typical_sigma.get(name) for name in names],
            "free": [name in self.free for name in names],
        }

    def report(self, path: str | Path) -> None:
        """Write the report, one HTML file that stands alone."""
        from boresight.figures.report import render_report

        with writing(path):
            Path(path).write_text(render_report(self), encoding="utf-8")


@dataclass(frozen=True, kw_only=True, repr=False)
class Evaluation(Summarised, tree.Evaluation):
    """Two parameter sets on the same telemetry: `availability`, `rms_arc_rad` with `initial` and `final`, and their intervals.

    `shadow`: the frames on which they differ; None where it was not asked for.
    """

    sensor: str = ""
    stars_off_detector: StarsOffDetector = field(default_factory=StarsOffDetector)
    advice: list[str] = field(default_factory=list)
    shadow: ShadowOfSet | None = None

    def _summarise(self) -> Summary:
        return text.summarise_evaluation(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation JSON as plain lists, numbers and None."""
        document: dict[str, Any] = to_plain(self)
        if self.shadow is None:
            del document["shadow"]
        return document


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One fact about telemetry: `code`, `severity`, a sentence, how often, and the first rows."""

    code: str
    severity: str
    sentence: str
    count: int
    rows: list[int] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True, repr=False)
class Quality(Reported):
    """The quality of telemetry: counts, and findings, the worst first; the whole report is `boresight.quality/1`."""

    verdict: str
    findings: list[Finding]
    frames: int
    exposures: int
    stars: int
    matched: int
    usable: int
    usable_exposures: int
    usable_frames: int

    def _summarise(self) -> Summary:
        return text.summarise_quality(self)


@dataclass(frozen=True, kw_only=True, repr=False)
class Matches(NewTelemetry):
    """Telemetry with its stars matched again, how many of the given identities stood, and why others did not.

    The whole report, `boresight.matching/1`, has every exposure with its attitude.
    """

    given: int
    kept: int
    changed: int
    added: int
    removed: int
    matched: int
    frames: int
    valid_frames: int
    advice: list[str]

    def _summarise(self) -> Summary:
        return text.summarise_matches(self)


@dataclass(frozen=True, kw_only=True, repr=False)
class Extraction(NewTelemetry):
    """Telemetry extracted from images: what became of each image, what was found and assumed, in sentences.

    The whole report is `boresight.extraction/1`.
    """

    images: list[ExtractedImage]
    sentences: list[str]

    def _summarise(self) -> Summary:
        return text.summarise_extraction(self)


@dataclass(frozen=True, kw_only=True, repr=False)
class NewSensor(Summarised):
    """A sensor file that was made, with a reason for each number.

    `sensor`: to be given to `calibrate`. `document`: the file. `reasons`: a sentence by field. `proposal`: of one that stars
    proposed, what was solved, as numbers; else None. `sentences`: the same in words, and what was assumed.
    """

    sensor: Sensor
    document: dict[str, Any]
    reasons: dict[str, str]
    proposal: Proposal | None = None
    sentences: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, made: Described, proposal: Proposal | None = None, sentences: Sequence[str] = ()) -> NewSensor:
        """Give a sensor its face."""
        said = [*(() if proposal is None else proposal.sentences), *sentences]
        return cls(sensor=made.sensor, document=made.document, reasons=made.reasons, proposal=proposal, sentences=said)

    def _summarise(self) -> Summary:
        return text.summarise_new_sensor(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the sensor file."""
        return self.document

    def save(self, path: str | Path) -> None:
        """Write the sensor file."""
        with writing(path):
            Path(path).write_text(json.dumps(self.document, indent=1) + "\n")


@dataclass(frozen=True, kw_only=True)
class CameraFile:
    """A camera as a file of another program: its bytes, their description, and how far they are from the camera.

    `document`: schema `boresight.export/1`, with the lens, its parameters and sigmas. `misfit_px`: largest over the detector.
    """

    content: bytes = field(repr=False)
    document: dict[str, Any] = field(repr=False)
    misfit_px: float

    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain lists, numbers and None."""
        return self.document

    def save(self, path: str | Path) -> None:
        """Write the file."""
        with writing(path):
            Path(path).write_bytes(self.content)


@dataclass(frozen=True, kw_only=True)
class Simulation(Tabular):
    """Telemetry whose truth is known: a calibration set, and a validation set of another part of the sky."""

    sensor: Sensor
    telemetry: Telemetry = field(repr=False)
    validation: Telemetry = field(repr=False)
    truth: Values[float]
    scenario: dict[str, Any] = field(repr=False)

    def _columns(self) -> pa.Table:
        return tabulate(self.telemetry)

    def save(self, folder: str | Path, suffix: Literal["csv", "parquet"] = "csv") -> None:
        """Write both sets, sensor.json, truth.json and scenario.json into a folder, which is made."""
        with writing(folder):
            place = Path(folder)
            place.mkdir(parents=True, exist_ok=True)
        save_telemetry(self.telemetry, place / f"calibration.{suffix}")
        save_telemetry(self.validation, place / f"validation.{suffix}")
        documents = {"sensor": self.scenario["sensor"], "truth": self.scenario["truth"], "scenario": self.scenario}
        for name, document in documents.items():
            text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
            (place / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


@dataclass(frozen=True, kw_only=True, repr=False)
class Assessment(Summarised):
    """A calibration held against gates: the worst answer, in words, what would block it, and what every gate answered.

    A gate's `status` is PASS, MARGINAL, NO-DATA or FAIL, beside what was measured, its limit, and a sentence.
    """

    sensor: str
    verdict: str
    words: str
    blocking: list[str]
    gates: list[GateAnswer]
    document: dict[str, Any] = field(default_factory=dict, repr=False)

    def _summarise(self) -> Summary:
        return text.summarise_assessment(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the whole report as plain lists, numbers and None."""
        return self.document


def parse_report(kind: type[Any], document: Mapping[str, Any], **others: Any) -> Any:
    """Parse a report as one of these dataclasses; the whole report stays in `document`."""
    names = {item.name for item in fields(kind)}
    return kind(**{name: value for name, value in document.items() if name in names}, **others, document=dict(document))


def tabulate(telemetry: Telemetry) -> pa.Table:
    """Return telemetry as a table of the columns of the telemetry format."""
    from boresight.telemetry.writing import contract_table

    return contract_table(telemetry)


def save_telemetry(telemetry: Telemetry, path: Path) -> None:
    """Write telemetry by the ending of a file's name."""
    from boresight.telemetry.writing import contract_table, write_table

    if path.suffix.lower() not in {".csv", ".jsonl", ".ndjson", ".parquet"}:
        raise RefusedInputError(f"{path.name} has no known format: end the name with .csv, .jsonl or .parquet.")
    with writing(path), path.open("wb") as stream:
        write_table(contract_table(telemetry), stream, path.suffix.lower())
