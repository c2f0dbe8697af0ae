"""A set of images with the telemetry that was extracted from it, in one ZIP file: what a server keeps, and what people may upload.

The images are stored as they are, for they hardly compress, in the order of their names and without times of their own, so that
the same images make the same bytes. Beside them `telemetry.parquet` says which image is which frame.
"""

from __future__ import annotations

import hashlib
import lzma
import mmap
import shutil
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from boresight.errors import CorruptFileError, NotFoundError, RefusedInputError
from boresight.images.extraction import Extraction
from boresight.images.limits import ImageLimits, ImageSource, is_image
from boresight.images.picture import make_picture
from boresight.images.reading import read_image
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.working_table import FrameImage, find_image
from boresight.telemetry.writing import write_parquet

TELEMETRY = "telemetry.parquet"
#: ZIP knows no earlier time.
NO_TIME = (1980, 1, 1, 0, 0, 0)
MOST_COMPRESSION = 200
LONGEST_NAME = 200
#: Of an archive, images and others: each takes memory and time before its name is known.
MOST_MEMBERS = 20_000
_MEMBER = b"PK\x01\x02"
COPIED_BYTES = 1 << 20


def unpack(path: Path, name: str, folder: Path, limits: ImageLimits) -> list[ImageSource]:
    """Unpack the images of an archive into a folder; everything else in it is left.

    Raises
    ------
    RefusedInputError
        When there are too many, they are too large or say one size and have another, or the archive is damaged.
    """
    _refuse_count(path, name)
    try:
        with zipfile.ZipFile(path) as archive:
            members = [one for one in archive.infolist() if _is_wanted(one)]
            _refuse_members(members, name, limits)
            sources = []
            for number, member in enumerate(members):
                place = folder / f"{number}"
                with archive.open(member) as packed, place.open("wb") as file:
                    shutil.copyfileobj(packed, file, COPIED_BYTES)
                sources.append(ImageSource(place, _base(member.filename)))
    except (
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, NotImplementedError, RuntimeError, OSError
    ) as error:  # fmt: skip
        raise RefusedInputError(
            f"{name} is a damaged ZIP, has a password, or uses a compression that cannot be read ({error}): pack the images again."
        ) from error
    return sources


def _refuse_count(path: Path, name: str) -> None:
    """Refuse an archive of too many members, counted before they are listed."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        place, count = data.find(_MEMBER), 0
        while place >= 0:
            count += 1
            if count > MOST_MEMBERS:
                raise RefusedInputError(f"{name} contains over {MOST_MEMBERS:,} files: pack only the images.")
            place = data.find(_MEMBER, place + 1)


def _is_wanted(member: zipfile.ZipInfo) -> bool:
    return not member.is_dir() and not _base(member.filename).startswith(".") and is_image(Path(_base(member.filename)))


def _base(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).name[-LONGEST_NAME:]


def _refuse_members(members: list[zipfile.ZipInfo], name: str, limits: ImageLimits) -> None:
    """Refuse by what an archive says of its members, before any is unpacked; none can be larger than it says."""
    if not members:
        raise RefusedInputError(f"{name} contains no image: pack FITS, PNG, TIFF or raw files.")
    if len(members) > limits.images:
        raise RefusedInputError(
            f"{name} contains {len(members):,} images, at most {limits.images:,} are accepted at once: split the set."
        )
    whole = sum(one.file_size for one in members)
    packed = max(1, sum(one.compress_size for one in members))
    if max(one.file_size for one in members) > limits.file_bytes or whole > min(
        limits.images * limits.file_bytes, MOST_COMPRESSION * packed
    ):
        raise RefusedInputError(
            f"{name} would unpack to {whole / 1e6:,.0f} MB, more than images of its size have: split the set."
        )


def pack(sources: Sequence[ImageSource], extraction: Extraction, place: Path) -> None:
    """Write images and what was extracted from them into an archive."""
    with zipfile.ZipFile(place, "w", zipfile.ZIP_STORED) as archive:
        for source in sorted(sources, key=lambda one: one.name):
            with (
                source.path.open("rb") as file,
                archive.open(zipfile.ZipInfo(source.name, NO_TIME), "w", force_zip64=True) as packed,
            ):
                shutil.copyfileobj(file, packed, COPIED_BYTES)
        table = place.with_name(f"{place.name}.table")
        write_parquet(extraction.telemetry, table)
        archive.writestr(zipfile.ZipInfo(TELEMETRY, NO_TIME), table.read_bytes())
        table.unlink()


def draw_image(
    path: Path, sensor: Sensor, frame: int, limits: ImageLimits, folder: Path, known: FrameImage | None = None
) -> bytes:
    """Return the image of a frame of an archive as a PNG of 8 bits, stretched so that sky and faint stars are seen.

    Parameters
    ----------
    folder
        Where files may be put meanwhile.
    known
        Which image the frame is; the archive's own telemetry says it where left out.

    Raises
    ------
    NotFoundError
        When the archive has no image of this frame.
    CorruptFileError
        When the image's bytes are not those that its stars were extracted from.
    """
    with zipfile.ZipFile(path) as archive:
        image = known or _find_packed(archive, frame, folder)
        if image.name not in archive.namelist():
            raise NotFoundError(f"There is no image of frame {frame}; choose a frame of this set.")
        place = folder / "image"
        with archive.open(image.name) as packed, place.open("wb") as file:
            shutil.copyfileobj(packed, file, COPIED_BYTES)
    with place.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != image.sha256:
        raise CorruptFileError(
            f"{image.name} is not the image that the stars of frame {frame} were extracted from (SHA-256 {found[:12]}, expected "
            f"{image.sha256[:12]}), so it is not drawn: restore the set from a backup, or upload the images again.",
            image.sha256,
            code="altered-file",
        )
    return make_picture(read_image(place, sensor, name=image.name, limits=limits).dn)


def _find_packed(archive: zipfile.ZipFile, frame: int, folder: Path) -> FrameImage:
    """Return which image a frame is by the telemetry in an archive."""
    if TELEMETRY not in archive.namelist():
        raise NotFoundError("This set contains no images of its frames; choose one that was extracted from images.")
    table = folder / TELEMETRY
    table.write_bytes(archive.read(TELEMETRY))
    telemetry = read_telemetry(table)
    rows = np.flatnonzero(telemetry.frame == frame)
    image = find_image(telemetry, int(rows[0])) if len(rows) else None
    if image is None:
        raise NotFoundError(f"There is no image of frame {frame}; choose a frame of this set.")
    return image
