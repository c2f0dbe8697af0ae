"""Boresight: recalibrating star trackers on orbit, from downlinked star centroids.

THE NOTATION. After this page any file can be read.

Frames
------
=====  =====================================================================================================
ICRS   inertial; catalogue directions. Apparent directions (aberrated) are given in ICRS axes.
D      detector: x along increasing rows (m), y along increasing columns (n), z out along the boresight.
S      sensor: the chassis; C_SD turns a D vector into an S vector. Arclengths cannot see a bulk rotation.
=====  =====================================================================================================

A vector in frame A is `s_a` and a matrix from B to A is `C_ab`, so `s_d = C_di @ s_i` and `C_si = C_sd @ C_di`.

Parity
------
+1: the axes (rows, columns, boresight) are a right-handed triad. -1: they are left-handed, as in an upright image.
Arclengths and singular values do not see parity; attitude does. With parity -1 the detector vector
(x, y, z) stands for the right-handed vector (x, -y, z).

Pixels
------
The centre of the top-left pixel is (0, 0); an integer is a pixel centre. `row_px` = m, `col_px` = n.
Not chosen: 1-based (FITS, MATLAB), corner-based (half a pixel off).

Quaternions
-----------
Stored (x, y, z, w), scalar last, Hamilton, turning ICRS vectors into D vectors: `s_d = C(q) @ s_i`.
Not chosen: scalar first; the inverse sense.

Units
-----
SI, radians and pixels inside. Where a number crosses a border (file, database, REST, page) its name ends with its unit:
`_m _px _rad _deg _s _km_s _per_m2 _per_m4 _c`. Times are UTC.

Symbols
-------
Enright, Jovanovic, Vaz 2018 ("E"), and the array names that carry them:

=============  ================  =============================================================================
f              `f_m`             focal length, metres
m_0, n_0       `m0_px n0_px`     principal point: row, column
b_4, b_2       `b4_per_m4 ...`   radial coefficients of rho in metres, applied from detector to ray
a_1, a_2       `a1_rad a2_rad`   decentring: linearised tilts of the detector
g_y            `g_y`             aspect: scale of columns over rows (the text calls it skew)
x              `x`               state, the parameters in the order f m0 n0 b4 b2 a1 a2 g_y
x'             `z`               scaled state, (x - x_ref) / sigma_p with the typical sigmas of E Table II
Delta          `pitch`           pixel pitch, metres
u v U V        `u v U V`         detector displacements before and after decentring, metres
rho, B         `rho2 B`          radius squared, radial factor
r, s           `r s`             ray and its unit vector
phi, dphi      `phi e`           arclength; measured minus catalogue
psi            `psi`             dihedral angle between two arcs at their common star
R              `R`               covariance of the arcs of one exposure, half-bandwidth 4
Xi             `L`               its lower Cholesky factor: R = L L^T
H, H'          `H`               Jacobian of dphi, and the same whitened and scaled
P, S           `P S`             state covariance, its upper triangular factor: P = S S^T
Q, M           `Q`               process noise
K, alpha       `K alpha`         gain, innovation variance
=============  ================  =============================================================================

Wu et al. 2019 ("W"), and the array names that carry them; u = column, v = row, and the pitch is D_u:

=============  ================  =============================================================================
s              `s`               aspect: height of a pixel over its width, D_v = s D_u
f              `f_m`             focal length, metres
u_0, v_0       `u0_px v0_px`     principal point: column, row
k_1, k_2       `k1 k2`           radial coefficients of the tangent r, applied from ray to detector
R, T           `reach T`         distorted radius r B over the focal length, and its slope dR/dr
x              `x`               state, the parameters in the order s f u0 v0 k1 k2
=============  ================  =============================================================================

The other cameras' letters stand in their files, `boresight.cameras`.

Arrays are structures of arrays, float64, and their docstrings name each dimension: `(n_stars,)`, `(n_arcs, n_parameters)`.
An *exposure* is one image; a *frame* is one telemetry reading (two exposures on the ST-16); a *set* is a series of frames.

References
----------
.. [E] J. Enright, I. Jovanovic, B. Vaz, "Autonomous Recalibration of Star Trackers", IEEE Sensors Journal, 2018,
   doi:10.1109/JSEN.2018.2857621.
.. [W] L. Wu, Q. Xu, J. Heikkilä, Z. Zhao, L. Liu, Y. Niu, "A Star Sensor On-Orbit Calibration Method Based on
   Singular Value Decomposition", Sensors 19, 2019.

Where a printed equation is wrong, the docstring that implements it says what is right and why; "erratum" marks the place.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from boresight.errors import (
        BoresightError,
        CancelledError,
        ConflictError,
        Fault,
        ForbiddenError,
        NotFoundError,
        RefusedInputError,
        StaleError,
        UnauthenticatedError,
        UnavailableError,
    )
    from boresight.library.alignment import Alignment
    from boresight.library.choice import Choice
    from boresight.library.client import AsyncClient, Client
    from boresight.library.diagnosis import Diagnosis
    from boresight.library.functions import (
        align,
        assess,
        calibrate,
        check,
        choose,
        diagnose,
        draw,
        evaluate,
        export_camera,
        extract,
        import_telemetry,
        load,
        match,
        new_sensor,
        plan,
        read_sensor,
        read_telemetry,
        simulate,
        simulate_images,
    )
    from boresight.library.pointings import PointingPlan
    from boresight.library.remote import RunFailedError
    from boresight.library.results import (
        Assessment,
        Calibration,
        CameraFile,
        Evaluation,
        Extraction,
        Matches,
        NewSensor,
        Quality,
        Simulation,
    )
    from boresight.telemetry.imports.mapping import Imported
    from boresight.telemetry.schema import Telemetry
    from boresight.telemetry.sensors import Sensor

#: Declared here alone: package, command, REST and documents take it from here, and tests hold the other files to it.
__version__ = "1.0.0"

#: Every name of the library, by the module that has it; a module is loaded when one of its names is first asked for.
_PLACES = {
    "boresight.library.functions": (
        "align",
        "assess",
        "calibrate",
        "check",
        "choose",
        "diagnose",
        "draw",
        "evaluate",
        "export_camera",
        "extract",
        "import_telemetry",
        "load",
        "match",
        "new_sensor",
        "plan",
        "read_sensor",
        "read_telemetry",
        "simulate",
        "simulate_images",
    ),
    "boresight.library.results": (
        "Assessment",
        "Calibration",
        "CameraFile",
        "Evaluation",
        "Extraction",
        "Matches",
        "NewSensor",
        "Quality",
        "Simulation",
    ),
    "boresight.library.alignment": ("Alignment",),
    "boresight.library.choice": ("Choice",),
    "boresight.library.diagnosis": ("Diagnosis",),
    "boresight.library.pointings": ("PointingPlan",),
    "boresight.telemetry.imports.mapping": ("Imported",),
    "boresight.telemetry.schema": ("Telemetry",),
    "boresight.telemetry.sensors": ("Sensor",),
    "boresight.library.client": ("AsyncClient", "Client"),
    "boresight.library.remote": ("RunFailedError",),
    "boresight.errors": (
        "BoresightError",
        "CancelledError",
        "ConflictError",
        "Fault",
        "ForbiddenError",
        "NotFoundError",
        "RefusedInputError",
        "StaleError",
        "UnauthenticatedError",
        "UnavailableError",
    ),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "Alignment",
    "Assessment",
    "AsyncClient",
    "BoresightError",
    "Calibration",
    "CameraFile",
    "CancelledError",
    "Choice",
    "Client",
    "ConflictError",
    "Diagnosis",
    "Evaluation",
    "Extraction",
    "Fault",
    "ForbiddenError",
    "Imported",
    "Matches",
    "NewSensor",
    "NotFoundError",
    "PointingPlan",
    "Quality",
    "RefusedInputError",
    "RunFailedError",
    "Sensor",
    "Simulation",
    "StaleError",
    "Telemetry",
    "UnauthenticatedError",
    "UnavailableError",
    "align",
    "assess",
    "calibrate",
    "check",
    "choose",
    "diagnose",
    "draw",
    "evaluate",
    "export_camera",
    "extract",
    "import_telemetry",
    "load",
    "match",
    "new_sensor",
    "plan",
    "read_sensor",
    "read_telemetry",
    "simulate",
    "simulate_images",
]


if not TYPE_CHECKING:  # a type checker shall miss what is not imported above

    def __getattr__(name: str) -> Any:
        """Load a name of the library when it is first asked for."""
        if name not in _MODULES:
            raise AttributeError(f"module 'boresight' has no attribute {name!r}")
        module = _MODULES[name]
        # what lies below the library, and what loads that, may load kernels, which must know their folder
        if module == "boresight.library.choice" or not module.startswith(("boresight.library.", "boresight.errors")):
            import_module("boresight.library.functions").use_kernels()
        globals()[name] = value = getattr(import_module(module), name)
        return value


def __dir__() -> list[str]:
    """List the names of the library too, so that a notebook completes them."""
    return sorted({*globals(), *__all__})
