"""Estimators of others on the same stars, by name: what problem each solves, what it needs, and how many frames it can bear.

Three problems are told apart, since times and errors compare only within one:

- `arcs`: eight parameters from the arclengths between stars with their covariance, Boresight's own problem and camera model;
- `attitudes`: the same eight and three angles of attitude a view as nuisance, bundle adjustment without translations. Its optimum
  is that of the arcs to a part in a thousand of sigma, its work is larger;
- `poses`: a general calibrator, with a translation a view besides and a camera model of its own. Stars have no parallax, so that a
  translation trades with the focal length: another problem, given here because it is the tool at hand.

A peer is a function of the views that returns an `Answer`. Whatever it imports is imported inside it.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field

from boresight.arrays import FloatArray
from boresight.measurements.detector_errors import Directions
from boresight.measurements.views import Views


@dataclass(frozen=True)
class Answer:
    """What an estimator says of a set.

    Parameters
    ----------
    directions
        Its camera.
    focal_length_m
        Of its camera.
    rms_px
        Root mean square residual of one axis that it is left with or reports, pixels; None when it has none.
    x, sigma
        (8,) estimate and its claimed standard deviations in our parameters, SI; None for a camera model of its own.
    P
        (8, 8) claimed covariance in typical sigmas, or None.
    focal_sigma_m
        Its claimed standard deviation of the focal length, or None.
    notes
        What it says about itself, such as that it did not converge.
    """

    directions: Directions
    focal_length_m: float
    rms_px: float | None = None
    x: FloatArray | None = None
    P: FloatArray | None = None
    focal_sigma_m: float | None = None
    notes: dict[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Peer:
    """One estimator.

    Parameters
    ----------
    function
        `module:function` within this package.
    title
        As tables call it.
    problem
        `arcs`, `attitudes` or `poses`.
    unfair
        What is not the same, in a sentence.
    needs
        Package that must be installed, as it is imported, and as it is named to be installed.
    frames
        Most frames it is given.
    """

    function: str
    title: str
    problem: str
    unfair: str
    needs: tuple[str, str] | None = None
    frames: int = 1_000_000

    @property
    def installed(self) -> bool:
        """Whether what it needs is there."""
        return self.needs is None or importlib.util.find_spec(self.needs[0]) is not None

    def estimator(self) -> Callable[[Views], Answer]:
        """Load the function."""
        module, _, name = self.function.partition(":")
        found: Callable[[Views], Answer] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
        return found


PREPARED = (
    "The order of the stars is Boresight's and not counted; R is Boresight's, inverted as full matrices, and counted."
)
OPENCV, FILTERPY = ("cv2", "opencv-python-headless"), ("filterpy", "filterpy")

PEERS: dict[str, Peer] = {
    "boresight_batch": Peer("boresight:batch_fit", "Boresight, batch", "arcs", "Ordering the stars and R are counted."),
    "boresight_sqrf": Peer("boresight:square_root", "Boresight, square-root filter", "arcs", "Ordering and R are counted."),
    "scipy_least_squares": Peer("on_arcs:scipy_least_squares", "SciPy least_squares", "arcs", PREPARED),
    "numpy_ekf": Peer("on_arcs:numpy_extended", "NumPy, extended filter", "arcs", PREPARED),
    "filterpy_ekf": Peer("on_arcs:filterpy_extended", "filterpy, ExtendedKalmanFilter", "arcs", PREPARED, FILTERPY),
    "filterpy_sqrf": Peer("on_arcs:filterpy_square_root", "filterpy, SquareRootKalmanFilter", "arcs", PREPARED, FILTERPY),
    "pyceres": Peer(
        "bundle:ceres", "Ceres (pyceres)", "attitudes",
        "Three attitude angles a view are estimated besides; the cost is written in Python, analytic, one call a view.",
        ("pyceres", "pyceres"), 50,
    ),
    "opencv_sphere": Peer(
        "opencv:sphere", "OpenCV calibrateCamera, stars on a unit sphere", "poses",
        "Stars are points at distance one, and a translation a view is estimated besides; its time grows with the square of views.",
        OPENCV, 50,
    ),
    "opencv_plane": Peer(
        "opencv:plane", "OpenCV calibrateCamera, stars on a plane a view", "poses",
        "Each view's stars are a flat target at distance one, and a translation a view is estimated besides.", OPENCV, 50,
    ),
    "opencv_fisheye": Peer(
        "opencv:fisheye", "OpenCV fisheye.calibrate, stars on a plane a view", "poses",
        "As the plane, with an equidistant lens and no decentring.", OPENCV, 50,
    ),
    "tetra3rs_radial": Peer(
        "tetra3:radial", "tetra3rs calibrate_camera, radial", "poses",
        "It finds attitude and matches itself, from its own catalogue, which is counted; no translation.", ("tetra3rs", "tetra3rs"),
    ),
    "tetra3rs_polynomial": Peer(
        "tetra3:polynomial", "tetra3rs calibrate_camera, polynomial", "poses",
        "It finds attitude and matches itself, from its own catalogue, which is counted; no translation.", ("tetra3rs", "tetra3rs"),
    ),
}  # fmt: skip
