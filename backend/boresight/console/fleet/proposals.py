"""A sensor proposed from uploaded stars: images or telemetry are solved in processes of their own, and nothing is stored."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.images.limits import ImageLimits, ImageSource, is_archive
from boresight.platform.actors import Actor, require_role
from boresight.telemetry.data_sheets import LensAndDetector
from boresight.telemetry.new_sensor import Described
from boresight.telemetry.read.limits import Limits

#: What a person calls the sensor that is proposed.
SUBJECT = "The new sensor"


def require_registrar(actor: Actor) -> None:
    """Refuse whoever could not register what is proposed."""
    require_role(actor, "analyst", "administrator")


def propose_of_images(
    sources: Sequence[ImageSource],
    known: LensAndDetector,
    catalogue_folder: Path,
    limits: ImageLimits,
    seconds: float,
) -> tuple[Described, list[str]]:
    """Extract and solve images; returns the sensor and what is to be said of it. `seconds` hold for each of both."""
    from boresight.calibration.proposal import propose_apart  # noqa: PLC0415 - heavy, and of uploads alone
    from boresight.images import extraction  # noqa: PLC0415 - as above
    from boresight.images.detection import DetectionOptions  # noqa: PLC0415 - as above

    sized = extraction.sensor_of_images(sources, known, limits=limits, subject=SUBJECT)
    found = extraction.extract_apart(sources, sized, DetectionOptions(), seconds=seconds, limits=limits)
    whole = replace(known, rows=sized.rows, columns=sized.columns)
    proposal = propose_apart(found.telemetry, catalogue_folder, whole, of_images=True, seconds=seconds, subject=SUBJECT)
    return proposal.described, [*proposal.sentences, *found.sentences]


def propose_of_file(
    path: Path,
    name: str,
    known: LensAndDetector,
    catalogue_folder: Path,
    limits: tuple[Limits, ImageLimits],
    seconds: float,
) -> tuple[Described, list[str]]:
    """Solve a telemetry file, or an archive of images, as `propose_of_images` does."""
    if is_archive(path):
        from boresight.images import archive  # noqa: PLC0415 - as above

        with tempfile.TemporaryDirectory() as folder:
            sources = archive.unpack(path, name, Path(folder), limits[1])
            return propose_of_images(sources, known, catalogue_folder, limits[1], seconds)
    from boresight.calibration.proposal import propose_apart  # noqa: PLC0415 - as above

    stars = TelemetryFile(path, name, limits=limits[0])
    proposal = propose_apart(stars, catalogue_folder, known, of_images=False, seconds=seconds, subject=SUBJECT)
    return proposal.described, proposal.sentences
