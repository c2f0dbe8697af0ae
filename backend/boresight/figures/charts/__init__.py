"""Every chart of the product, chapter by chapter; a new one is one file and one line here."""

from __future__ import annotations

from boresight.figures.chart import Figure
from boresight.figures.charts.arc_uncertainty import ARC_UNCERTAINTY
from boresight.figures.charts.convergence import CONVERGENCE
from boresight.figures.charts.correlation import CORRELATION
from boresight.figures.charts.coverage import COVERAGE
from boresight.figures.charts.drop_one import DROP_ONE
from boresight.figures.charts.efficiency import EFFICIENCY
from boresight.figures.charts.frame_observability import FRAME_OBSERVABILITY, REFERENCE_INFORMATION
from boresight.figures.charts.innovations import INNOVATIONS, WHITENESS
from boresight.figures.charts.matching import MATCHING
from boresight.figures.charts.methods import METHODS
from boresight.figures.charts.more_data import MORE_DATA
from boresight.figures.charts.observability import OBSERVABILITY
from boresight.figures.charts.parameters import PARAMETERS
from boresight.figures.charts.radial import DISTORTION, RADIAL
from boresight.figures.charts.residual_against import RESIDUAL_AGAINST
from boresight.figures.charts.residual_distribution import RESIDUAL_DISTRIBUTION
from boresight.figures.charts.residual_map import RESIDUAL_MAP, RESIDUAL_QUIVER, RESIDUAL_RMS
from boresight.figures.charts.residual_outliers import RESIDUAL_OUTLIERS
from boresight.figures.charts.residual_spline import RESIDUAL_SPLINE
from boresight.figures.charts.rms import RMS, RMS_AXES
from boresight.figures.charts.shadow import SHADOW
from boresight.figures.charts.smoothed import SMOOTHED
from boresight.figures.charts.stars import STARS
from boresight.figures.charts.two_halves import TWO_HALVES

CHAPTERS: dict[str, tuple[Figure, ...]] = {
    "summary": (PARAMETERS, CORRELATION),
    "convergence": (CONVERGENCE, SMOOTHED, METHODS),
    "rms": (RMS, RMS_AXES),
    "distortion": (RADIAL, DISTORTION, COVERAGE),
    "observability": (OBSERVABILITY, FRAME_OBSERVABILITY, REFERENCE_INFORMATION),
    "residuals": (
        RESIDUAL_QUIVER,
        RESIDUAL_SPLINE,
        RESIDUAL_DISTRIBUTION,
        RESIDUAL_AGAINST,
        INNOVATIONS,
        WHITENESS,
        RESIDUAL_RMS,
        RESIDUAL_OUTLIERS,
        RESIDUAL_MAP,
    ),
    "trust": (TWO_HALVES, ARC_UNCERTAINTY, EFFICIENCY, MORE_DATA, DROP_ONE, STARS),
    "matching": (MATCHING, SHADOW),
}
FIGURES: dict[str, Figure] = {figure.name: figure for chapter in CHAPTERS.values() for figure in chapter}
WIDE = frozenset(name for name, figure in FIGURES.items() if figure.wide)
