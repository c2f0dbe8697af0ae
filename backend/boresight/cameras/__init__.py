"""Camera models, one a file: whatever file of this folder defines one is found; `model` says what follows from it."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from boresight.cameras.model import CameraModel, Role

CAMERA_MODELS: dict[str, CameraModel] = {
    value.name: value
    for module in iter_modules(__path__, f"{__name__}.")
    for value in vars(import_module(module.name)).values()
    if isinstance(value, CameraModel)
}
#: What is compiled beforehand and shown as an example where no sensor says which camera it has.
DEFAULT_CAMERA = CAMERA_MODELS["inverted_wang"]


def usual_camera(half_field_deg: float = 0.0) -> CameraModel:
    """Return the camera that is taken where nobody names one, by half the field of view."""
    usual = {camera.usual.from_deg: camera for camera in CAMERA_MODELS.values() if camera.usual is not None}
    return usual[max(start for start in usual if start <= half_field_deg)]


def name_camera_with(role: Role) -> str:
    """Name a camera that has a parameter of a role, for sentences that advise one."""
    return min(name for name, camera in CAMERA_MODELS.items() if role in {one.role for one in camera.parameters})


__all__ = ["CAMERA_MODELS", "DEFAULT_CAMERA", "CameraModel", "name_camera_with", "usual_camera"]
