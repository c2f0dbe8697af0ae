"""An alignment as the library returns it: with its gates, a summary, and a table of its pairs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from boresight.calibration.alignment import result
from boresight.calibration.calibration import to_plain
from boresight.library.results import Summarised, Tabular
from boresight.library.text import Summary, written

if TYPE_CHECKING:
    import plotly.graph_objects as go
    import pyarrow as pa

    from boresight.verdicts.gates import GateReport

#: Removed pairs that are named on a terminal.
MOST_NAMED = 5


@dataclass(frozen=True, kw_only=True, repr=False)
class Alignment(Summarised, Tabular, result.Alignment):
    """The rotation between two frames: `quaternion`, `matrix` (C_SD where B is the frame S), sigmas in arcsec, `terms`, `gates`.

    `at(temperature_c, days)` gives it at another temperature and time, with its covariance.
    """

    report: GateReport = field(repr=False)

    @classmethod
    def of(cls, found: result.Alignment, report: GateReport) -> Alignment:
        """Give an alignment its face."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(found)}, report=report)

    @property
    def verdict(self) -> str:
        """The worst answer of the gates: PASS, MARGINAL, NO-DATA or FAIL."""
        return self.report.verdict

    def to_dict(self) -> dict[str, Any]:
        """Return the alignment JSON, the gates' report under `gate_report`, as plain lists, numbers and None."""
        document = to_plain(self)
        return {
            **{name: value for name, value in document.items() if name != "report"},
            "gate_report": document["report"],
        }

    def save(self, path: str | Path) -> None:
        """Write the alignment JSON."""
        Path(path).write_text(json.dumps(self.to_dict(), indent=1) + "\n")

    def draw(self, *, theme: Literal["light", "dark", "contrast"] = "light") -> go.Figure:
        """Draw the angles of the pairs over time and temperature."""
        from boresight.figures.alignment import draw
        from boresight.figures.notebook import on_paper

        return on_paper(draw(self), theme)

    def _columns(self) -> pa.Table:
        import pyarrow as pa

        pairs = self.residuals
        columns: dict[str, Any] = {"time_utc": pairs.time_utc, "temperature_c": pairs.temperature_c}
        for what, values in (("residual", pairs.residual_arcsec), ("sigma", pairs.sigma_arcsec)):
            columns |= {f"{what}_{axis}_arcsec": [row[k] for row in values] for k, axis in enumerate(result.AXES)}
        return pa.table({**columns, "probability": pairs.probability, "kept": pairs.kept})

    def _summarise(self) -> Summary:
        rows: list[Sequence[str]] = [("about the axes of B", *result.AXES, "unit")]
        rows += [(name, *(written(one, ".3g") for one in values), unit) for name, values, unit in self._rows()]
        return Summary(f"{self.verdict}: {self.sentence}", rows, (0, 4), [*self._sentences()])

    def _rows(self) -> Iterator[tuple[str, Sequence[float], str]]:
        yield "3 sigma to load with these parameters", [3 * one for one in self.to_load.sigma_arcsec], "arcsec"
        yield "3 sigma between the frames, with misfit", [3 * one for one in self.sigma_with_misfit_arcsec], "arcsec"
        yield "3 sigma between the frames", [3 * one for one in self.sigma_arcsec], "arcsec"
        for term in self.terms:
            yield term.name, term.value_arcsec, f"arcsec/{term.unit}"
            yield f"{term.name}, 3 sigma", [3 * one for one in term.sigma_arcsec], f"arcsec/{term.unit}"

    def _sentences(self) -> Iterator[str]:
        for what, quaternion in (("to load", self.to_load.quaternion), ("between the frames", self.quaternion)):
            numbers = ", ".join(f"{one:.9f}" for one in quaternion)
            yield f"quaternion x, y, z, w from {self.a.name} to {self.b.name}, {what}: {numbers}"
        warmth = "" if self.reference_temperature_c is None else f" at {self.reference_temperature_c:.2f} °C"
        used = f"{self.pairs_used:,} of {self.pairs:,} pairs, {self.interpolated:,} interpolated"
        yield f"reference time {self.reference_utc}{warmth}; {used}"
        for test in self.tests:
            needed = "needed" if test.needed else "not needed"
            yield f"{test.name}: {needed}, chi-square falls by {test.fall:.3g} (p = {test.p:.2g})"
        for one in self.removed[:MOST_NAMED]:
            frames = ", ".join(
                f"frame {n} of {side.name}"
                for n, side in ((one.frame_a, self.a), (one.frame_b, self.b))
                if n is not None
            )
            yield f"left out: {one.time_utc}, {frames}: {one.angle_arcsec:.3g} arcsec off (p = {one.probability:.2g})"
        if len(self.removed) > MOST_NAMED:
            yield f"and {len(self.removed) - MOST_NAMED:,} more; use --json to list all"
        yield from self.advice
        for gate in self.report.gates:
            if gate.status != "PASS":
                yield f"{gate.title} {gate.status}: {gate.sentence}"
