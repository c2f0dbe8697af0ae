"""Every chart of the product, each a pure function of calibration JSON; a new one is one file and one line here."""

from boresight.figures.chart import Figure, Result, Table, Trace, figure_json
from boresight.figures.convergence import CONVERGENCE
from boresight.figures.coverage import COVERAGE
from boresight.figures.observability import OBSERVABILITY
from boresight.figures.parameters import PARAMETERS
from boresight.figures.radial import RADIAL
from boresight.figures.rms import RMS

__all__ = ["FIGURES", "Figure", "Result", "Table", "Trace", "figure_json"]

FIGURES: dict[str, Figure] = {
    figure.name: figure for figure in (CONVERGENCE, RMS, RADIAL, OBSERVABILITY, COVERAGE, PARAMETERS)
}
