"""Every chart of the product, chapter by chapter; a new one is one file and one line here."""

from boresight.figures.arc_uncertainty import ARC_UNCERTAINTY
from boresight.figures.chart import Figure
from boresight.figures.convergence import CONVERGENCE
from boresight.figures.correlation import CORRELATION
from boresight.figures.coverage import COVERAGE
from boresight.figures.distortion import DISTORTION
from boresight.figures.drop_one import DROP_ONE
from boresight.figures.efficiency import EFFICIENCY
from boresight.figures.frame_observability import FRAME_OBSERVABILITY
from boresight.figures.innovations import INNOVATIONS
from boresight.figures.matching import MATCHING
from boresight.figures.methods import METHODS
from boresight.figures.more_data import MORE_DATA
from boresight.figures.observability import OBSERVABILITY
from boresight.figures.parameters import PARAMETERS
from boresight.figures.radial import RADIAL
from boresight.figures.reference_information import REFERENCE_INFORMATION
from boresight.figures.residual_against import RESIDUAL_AGAINST
from boresight.figures.residual_distribution import RESIDUAL_DISTRIBUTION
from boresight.figures.residual_map import RESIDUAL_MAP
from boresight.figures.residual_outliers import RESIDUAL_OUTLIERS
from boresight.figures.residual_quiver import RESIDUAL_QUIVER
from boresight.figures.residual_rms import RESIDUAL_RMS
from boresight.figures.rms import RMS
from boresight.figures.rms_axes import RMS_AXES
from boresight.figures.shadow import SHADOW
from boresight.figures.stars import STARS
from boresight.figures.two_halves import TWO_HALVES
from boresight.figures.whiteness import WHITENESS

CHAPTERS: dict[str, tuple[Figure, ...]] = {
    "summary": (PARAMETERS, CORRELATION),
    "convergence": (CONVERGENCE, METHODS),
    "rms": (RMS, RMS_AXES),
    "distortion": (DISTORTION, RADIAL, COVERAGE),
    "observability": (OBSERVABILITY, FRAME_OBSERVABILITY, REFERENCE_INFORMATION),
    "residuals": (
        RESIDUAL_QUIVER,
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
WIDE = frozenset(
    {
        "convergence", "methods", "rms", "rms-axes", "distortion", "radial", "observability", "frame-observability",
        "two-halves", "more-data", "residual-map", "residual-quiver", "residual-distribution", "residual-outliers",
        "stars", "matching", "shadow",
    }
)  # fmt: skip
