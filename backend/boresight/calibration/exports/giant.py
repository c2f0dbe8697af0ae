"""Camera models of NASA's GIANT: Brown's and Owen's, as the XML that `giant.camera_models.load` reads, or as JSON.

GIANT takes pixel centres at whole numbers from 0, x along columns, y along rows and z along the boresight. Its Brown is OpenCV's
with k1 k2 k3 p1 p2. Its Owen works in lengths on the focal plane, here millimetres: with f the focal length and d = f (x, y),

    d' = d (1 + e2 d^2 + e4 d^4 + e5 d_y + e6 d_x) + (e1 |d| + e3 |d|^3) (-d_y, d_x)       column = k_x d'_x + p_x

so a coefficient of the power n of the tangent is that of `lenses` over f^n. The XML names a camera `camera`; the JSON holds the
arguments of the class, as in `OwenModel(**document["arguments"])`, for GIANT itself has no JSON. A value in the XML is a Python
literal.
"""

from __future__ import annotations

import json
from xml.sax.saxutils import escape

from boresight.calibration.exports.export import Export, ExportFormat, Written, pack_lens, provenance
from boresight.calibration.exports.lenses import OWEN, PLUMB_BOB

NAME = "camera"
MM_PER_M = 1e3
#: Arguments of both classes by which a camera at one temperature, without misalignment, is whole.
SAME = {"a1": 0.0, "a2": 0.0, "a3": 0.0}


def _write(asked: Export, kind: str, arguments: dict[str, float | int]) -> Written:
    """Write one of GIANT's models by the ending of the file's name."""
    about = provenance(asked)
    whole = {"n_rows": asked.sensor.rows, "n_cols": asked.sensor.columns, **arguments, **SAME}
    if asked.suffix == ".json":
        text = json.dumps({"class": f"{kind}Model", "arguments": whole, "about": about}, indent=2)
        return pack_lens(asked, text + "\n")
    module = f"giant.camera_models.{kind.lower()}_model"
    values = {
        "field_of_view": None,
        "use_a_priori": False,
        **whole,
        "misalignment": "array([0.0, 0.0, 0.0])",
        "estimate_multiple_misalignments": False,
        "estimation_parameters": ["basic"],
        "_interp": None,
    }
    lines = [
        "<CameraModels>",
        *(f"  <!-- {escape(line.replace('--', '- -'))} -->" for line in about),
        f'  <{NAME} module="{module}" type="{kind}Model">',
        *(f"    <{name}>{escape(str(value))}</{name}>" for name, value in values.items()),
        f"  </{NAME}>",
        "</CameraModels>",
    ]
    return pack_lens(asked, "\n".join(lines) + "\n")


def _brown(asked: Export) -> Written:
    v = asked.lens.values
    arguments = {"kx": v["f_x"], "ky": v["f_y"], "px": v["c_x"], "py": v["c_y"]}
    if asked.suffix == ".xml":
        arguments |= {"focal_length": 1.0}  # the constructor has it so, and takes none
    arguments |= {name: v[name] for name in ("k1", "k2", "k3", "p1", "p2")} | {"alpha": 0.0}
    return _write(asked, "Brown", arguments)


def _owen(asked: Export) -> Written:
    v, pitch_mm = asked.lens.values, asked.sensor.pixel_pitch_m * MM_PER_M
    f = v["f_x"] * pitch_mm
    arguments = {"focal_length": f, "kx": v["f_x"] / f, "ky": v["f_y"] / f, "kxy": 0.0, "kyx": 0.0}
    arguments |= {"px": v["c_x"], "py": v["c_y"]}
    of = {"radial2": ("e2", 2), "radial4": ("e4", 4), "tangential_y": ("e5", 1), "tangential_x": ("e6", 1)}
    of |= {"pinwheel1": ("e1", 1), "pinwheel2": ("e3", 3)}
    arguments |= {name: v[short] / f**power for name, (short, power) in of.items()}
    return _write(asked, "Owen", arguments)


SUFFIXES = (".xml", ".json")
BROWN = ExportFormat(
    "giant-brown", "NASA GIANT", SUFFIXES, "application/xml", _brown, (PLUMB_BOB,),
    why=f"`BrownModel`: the XML of `giant.camera_models.load(file, {NAME!r})`, or its arguments as JSON",
)  # fmt: skip
GIANT_OWEN = ExportFormat(
    "giant-owen", "NASA GIANT", SUFFIXES, "application/xml", _owen, (OWEN,),
    why=f"`OwenModel`: the XML of `giant.camera_models.load(file, {NAME!r})`, or its arguments as JSON",
)  # fmt: skip
