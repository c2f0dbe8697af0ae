"""Reading one image: FITS by astropy, PNG and TIFF by Pillow, raw numbers by NumPy; and what it says of time and detector.

Nothing is expanded before its size is known: a FITS header and a PNG's or TIFF's head say how many pixels there are, gzip is
read up to the budget and no farther, and raw numbers must be exactly as many as the detector has.

Pixel (0, 0) is the first number of the file in every format, so row 0 is what FITS viewers draw at the bottom and others at
the top; `parity` of the sensor says which way round the sky is.

Times are of mid-exposure. In the order in which they are believed: a list of times, the FITS header (DATE-AVG; else DATE-BEG or
DATE-OBS plus half of EXPTIME), EXIF (its offset, else UTC is assumed), the file's name (20261124T220105.25, 2026-11-24_22-01-05).
"""

from __future__ import annotations

import gzip
import hashlib
import io
import re
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from boresight.arrays import FloatArray
from boresight.errors import RefusedInputError
from boresight.images.limits import LIMITS, SUFFIXES, ImageLimits
from boresight.telemetry.declarations import ImageFormat, parse_image_format
from boresight.telemetry.imports.recognition import leading_to_import
from boresight.telemetry.read.checks import EARLIEST, LATEST, Faults
from boresight.telemetry.sensors import Sensor

_MAGIC: Final = {
    b"SIMPLE  =": "FITS",
    b"\x1f\x8b": "FITS",
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"II*\x00": "TIFF",
    b"MM\x00*": "TIFF",
}
_FOREIGN: Final = {b"\xff\xd8\xff": "JPEG", b"II+\x00": "BigTIFF", b"GIF8": "GIF", b"BM": "BMP"}
#: Pillow's modes that hold one number a pixel, and those of colours that are taken together.
_GREY, _COLOUR = ("L", "I", "I;16", "I;16B", "I;16L", "F"), ("RGB", "RGBA", "LA", "P", "1")
_EXIF_TIME, _EXIF_PART, _EXIF_OFFSET, _EXIF_EXPOSURE, _EXIF_BLOCK = 36867, 37521, 36881, 33434, 0x8769
_NAMED_TIME = re.compile(
    r"(?<!\d)((?:19|20)\d\d)-?([01]\d)-?([0-3]\d)[T_ -]?([0-2]\d)[-:_h]?([0-5]\d)[-:_m]?([0-6]\d)(?:[.,](\d{1,6}))?(?!\d)"
)
_KEPT_BYTES = 1 << 20
_LONGEST_EXPOSURE_S = 86_400.0


@dataclass(frozen=True)
class Image:
    """One image as it was read.

    `dn`: (rows, columns). `sha256`: of the file's bytes. `time_utc`: mid-exposure, NaT where unknown; `time_source` says from what.
    `white_dn`: the largest number that can be, where the file says so.
    """

    name: str
    dn: FloatArray
    sha256: str
    time_utc: np.datetime64
    time_source: str
    exposure_s: float | None = None
    gain_e_per_dn: float | None = None
    white_dn: float | None = None
    temperature_c: float | None = None
    notes: tuple[str, ...] = ()


def parse_raw(document: Mapping[str, Any]) -> ImageFormat:
    """Read how raw numbers are to be read."""
    faults = Faults("The format of raw images")
    found = parse_image_format(document, faults)
    faults.refuse()
    return found


def read_image(
    path: Path,
    sensor: Sensor,
    raw: ImageFormat | None = None,
    *,
    name: str | None = None,
    times: Mapping[str, np.datetime64] | None = None,
    limits: ImageLimits = LIMITS,
) -> Image:
    """Read an image of a sensor.

    Parameters
    ----------
    path, name
        Where it is, and what its sender called it.
    sensor
        Says the size that it must have.
    raw
        How numbers without a header are to be read.
    times
        Mid-exposure by file name; believed before anything the file says.
    limits
        How much it may hold.

    Raises
    ------
    RefusedInputError
        When it cannot be used; names the file.
    """
    name = name or path.name
    content = _read_bytes(path, name, limits)
    read = _READERS[_find_form(content, name)]
    with leading_to_import(path, name):
        image = read(content, name, sensor, raw or sensor.image, limits)
    _check_size(image, sensor)
    return _timed(image, times)


def read_size(path: Path, name: str, limits: ImageLimits = LIMITS) -> tuple[int, int] | None:
    """Return rows and columns of an image; None of raw numbers, which have no shape.

    Raises RefusedInputError when it cannot be read.
    """
    content = _read_bytes(path, name, limits)
    form = _find_form(content, name)
    if form == "raw":
        return None
    with leading_to_import(path, name):
        rows, columns = (_read_fits if form == "FITS" else _read_picture)(content, name, None, None, limits).dn.shape
    return rows, columns


def _read_bytes(path: Path, name: str, limits: ImageLimits) -> bytes:
    """Read a file within the budget; refuses an empty one."""
    try:
        size = path.stat().st_size
        if size > limits.file_bytes:
            raise RefusedInputError(
                f"{name} is {size / 1e6:,.0f} MB; the limit is {limits.file_bytes / 1e6:,.0f} MB: bin or crop the image."
            )
        content = path.read_bytes()
    except OSError as error:
        raise RefusedInputError(
            f"{name} cannot be read: {error.strerror}; check the name and its permissions."
        ) from error
    if not content:
        raise RefusedInputError(f"{name} is empty: copy it again.")
    return content


def _find_form(content: bytes, name: str) -> str:
    """Tell by the first bytes what a file is; raw numbers by their name alone."""
    for magic, form in (_MAGIC | _FOREIGN).items():
        if content.startswith(magic):
            if form in _FOREIGN.values():
                raise RefusedInputError(
                    f"{name} is {form}, which is not supported: save it as FITS, or as PNG or TIFF of 16 bits."
                )
            return form
    if SUFFIXES.get(Path(name).suffix.lower()) == "raw":
        return "raw"
    raise RefusedInputError(
        f"{name} is neither FITS, PNG nor TIFF: check that it was copied completely; raw numbers end in .raw, .bin or .dat."
    )


def _check_size(image: Image, sensor: Sensor) -> None:
    """Refuse an image of another size than the detector's."""
    rows, columns = image.dn.shape
    if (rows, columns) == (sensor.rows, sensor.columns):
        return
    turned = (rows, columns) == (sensor.columns, sensor.rows)
    remedy = (
        "exchange rows and columns of the sensor file"
        if turned
        else "give the sensor file that belongs to it, or images of one camera"
    )
    raise RefusedInputError(
        f"{image.name} has {rows:,} rows and {columns:,} columns, the detector of {sensor.name} {sensor.rows:,} and "
        f"{sensor.columns:,}: {remedy}.",
        code="rows-and-columns-exchanged" if turned else "other-size",
    )


def _refuse_pixels(name: str, pixels: int, limits: ImageLimits) -> None:
    if pixels > limits.pixels:
        raise RefusedInputError(
            f"{name} has {pixels:,} pixels by its header; the limit is {limits.pixels:,}: bin or crop the image."
        )


def _read_fits(
    content: bytes, name: str, _sensor: Sensor | None, _raw: ImageFormat | None, limits: ImageLimits
) -> Image:
    """Read the first image of a FITS file."""
    from astropy.io import fits  # noqa: PLC0415 - 0.2 s

    digest = hashlib.sha256(content).hexdigest()
    if content.startswith(b"\x1f\x8b"):
        content = _expand(content, name, limits)
        if not content.startswith(b"SIMPLE  ="):
            raise RefusedInputError(
                f"{name} is compressed by gzip, and its content is not FITS: unpack it, and give the file inside by its name."
            )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers that break a rule and can be read all the same
        try:
            with fits.open(io.BytesIO(content), memmap=False, lazy_load_hdus=True) as file:
                part = next((one for one in file if one.is_image and len(one.shape) >= 2), None)
                if part is None:
                    raise RefusedInputError(  # noqa: TRY301 - it passes as it is
                        f"{name} contains no image, only headers or tables: give the file of the image itself."
                    )
                _refuse_pixels(name, int(np.prod(part.shape, dtype=np.int64)), limits)
                planes = [length for length in part.shape[:-2] if length > 1]
                if planes:
                    raise RefusedInputError(  # noqa: TRY301 - it passes as it is
                        f"{name} contains {np.prod(planes)} planes: write each exposure, or the sum of the colours, as a "
                        "separate image."
                    )
                if isinstance(part, fits.CompImageHDU):
                    _refuse_tiles(content, name, int(np.prod(part.shape, dtype=np.int64)))
                dn = np.asarray(part.data, dtype=np.float64).reshape(part.shape[-2:])
                header = dict(part.header) if part is file[0] else {**dict(file[0].header), **dict(part.header)}
        except RefusedInputError:
            raise
        except Exception as error:  # astropy raises what its parts raise on damaged files
            raise RefusedInputError(f"{name} is a damaged FITS file ({_short(error)}): copy it again.") from error
    dn, notes = _filled(dn, name)
    exposure = _positive(header.get("EXPTIME", header.get("EXPOSURE")))
    time, source = _header_time(header, exposure, name)
    return Image(
        name=name,
        dn=dn,
        sha256=digest,
        time_utc=time,
        time_source=source,
        exposure_s=exposure,
        gain_e_per_dn=_positive(header.get("EGAIN")),  # GAIN is a camera's setting as often as electrons a DN
        white_dn=_positive(header.get("SATURATE")),
        temperature_c=_number(header.get("CCD-TEMP")),
        notes=tuple(notes),
    )


def _filled(dn: FloatArray, name: str) -> tuple[FloatArray, list[str]]:
    """Return an image whose pixels without a number are as bright as its sky, and what is to be said of them."""
    known = np.isfinite(dn)
    if known.all():
        return dn, []
    note = f"{name}: {np.count_nonzero(~known):,} pixels have no value and are treated as sky"
    return np.where(known, dn, np.median(dn[known]) if known.any() else 0.0), [note]


def _refuse_tiles(content: bytes, name: str, pixels: int) -> None:
    """Refuse a compressed image whose tiles hold more than its pixels, before they are expanded whole."""
    from astropy.io import fits  # noqa: PLC0415 - 0.2 s

    left = 8 * pixels + _KEPT_BYTES
    with fits.open(io.BytesIO(content), memmap=False, disable_image_compression=True) as file:
        for table in (one for one in file if one.header.get("ZIMAGE")):
            tile = [int(table.header[key]) for key in table.header["ZTILE*"]]
            left -= max(0, 8 * int(np.prod(tile, dtype=object)) - 8 * pixels)  # object: whole numbers of any size
            is_gzip = str(table.header.get("ZCMPTYPE", "")).startswith("GZIP")
            columns = {"GZIP_COMPRESSED_DATA", *(["COMPRESSED_DATA"] if is_gzip else [])} & set(table.columns.names)
            for packed in (packed for column in columns for packed in table.data[column] if left >= 0):
                left -= len(zlib.decompressobj(31).decompress(bytes(packed), left + 1))
    if left < 0:
        raise RefusedInputError(
            f"The tiles of {name} contain more data than the image has pixels: save the image again."
        )


def _expand(content: bytes, name: str, limits: ImageLimits) -> bytes:
    """Expand gzip, up to the budget and no farther."""
    most = 8 * limits.pixels + _KEPT_BYTES
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            expanded = file.read(most + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise RefusedInputError(f"{name} is damaged gzip ({_short(error)}): copy it again.") from error
    if len(expanded) > most:
        raise RefusedInputError(
            f"{name} expands to over {most / 1e6:,.0f} MB, more than an image may have: bin or crop it.",
            code="expands-too-far",
        )
    return expanded


def _header_time(header: Mapping[str, Any], exposure: float | None, name: str) -> tuple[np.datetime64, str]:
    """Return mid-exposure of a FITS header, and the key that says it."""
    scale = str(header.get("TIMESYS", "UTC")).strip().upper()
    for key, is_middle in (("DATE-AVG", True), ("DATE-BEG", False), ("DATE-OBS", False)):
        text = str(header.get(key, "")).strip().removesuffix("Z")
        if "T" not in text:
            text = f"{text}T{str(header.get('TIME-OBS', '')).strip()}" if text and header.get("TIME-OBS") else ""
        if not text:
            continue
        time = _utc(text, scale, name, key)
        if is_middle:
            return time, key
        return _middle(time, exposure, name), key if exposure else f"{key}, without a time of exposure"
    return np.datetime64("NaT", "us"), ""


def _utc(text: str, scale: str, name: str, key: str) -> np.datetime64:
    """Read a time of a scale as UTC."""
    try:
        time = _convert_to_utc(text, scale)
        if not EARLIEST <= time < LATEST:
            raise ValueError(text)  # noqa: TRY301 - it is told as the others are
    except Exception as error:
        raise RefusedInputError(
            f"{name}: {key} = {text[:40]!r} ({scale[:12]}) is not a valid time: correct the header, or give --times."
        ) from error
    return time


def _convert_to_utc(text: str, scale: str) -> np.datetime64:
    if scale in {"UTC", "UT", "UT1", "GMT"}:
        return np.datetime64(text, "us")
    from astropy.time import Time  # noqa: PLC0415 - 0.3 s, of headers in another scale alone

    if scale == "GPS":
        return np.datetime64((Time(text, scale="tai", precision=6) + 19.0 / 86400.0).utc.isot, "us")
    return np.datetime64(Time(text, scale=scale.lower(), precision=6).utc.isot, "us")


def _middle(start: np.datetime64, exposure_s: float | None, name: str) -> np.datetime64:
    if exposure_s is None:
        return start
    if exposure_s > _LONGEST_EXPOSURE_S:
        raise RefusedInputError(
            f"The exposure time of {name} is {exposure_s:.6g} s, more than a day: correct the header."
        )
    return start + np.timedelta64(round(exposure_s / 2.0 * 1e6), "us")


def _read_picture(
    content: bytes, name: str, _sensor: Sensor | None, _raw: ImageFormat | None, limits: ImageLimits
) -> Image:
    """Read a PNG or a TIFF."""
    import PIL.Image  # noqa: PLC0415 - 30 ms

    notes: list[str] = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its own budget, for ours is kept
            with PIL.Image.open(io.BytesIO(content), formats=("PNG", "TIFF")) as picture:
                _refuse_pixels(name, picture.width * picture.height, limits)
                if getattr(picture, "n_frames", 1) > 1:
                    raise RefusedInputError(  # noqa: TRY301 - it passes as it is
                        f"{name} contains several images: write each to a separate file."
                    )
                if _is_cut_to_8_bits(content, picture.mode):
                    raise RefusedInputError(  # noqa: TRY301 - it passes as it is
                        f"{name} has colours of 16 bits, which are not supported: save one channel, or grey."
                    )
                mode, (time, source, exposure) = picture.mode, _exif_time(picture.getexif(), name)
                if mode in _COLOUR:
                    notes.append(f"{name}: its colours are averaged")
                    dn = np.asarray(picture.convert("RGB")).mean(axis=2, dtype=np.float64)
                elif mode in _GREY:
                    dn = np.asarray(picture, dtype=np.float64)
                else:
                    raise RefusedInputError(  # noqa: TRY301 - it passes as it is
                        f"{name} is of the kind {mode!r}, which is not supported: save it as grey of 8 or 16 bits."
                    )
    except RefusedInputError:
        raise
    except Exception as error:  # Pillow raises what its parts raise on damaged files
        raise RefusedInputError(
            f"{name} is damaged, or of a kind that is not supported ({_short(error)}): save it again."
        ) from error
    dn, unknown = _filled(dn, name)
    notes += unknown
    white = 255.0 if mode in {"L", *_COLOUR} else 65535.0 if mode.startswith("I;16") else None
    return Image(name, dn, hashlib.sha256(content).hexdigest(), time, source, exposure, None, white, notes=tuple(notes))


def _is_cut_to_8_bits(content: bytes, mode: str) -> bool:
    """Whether a PNG has colours of 16 bits, of which Pillow keeps 8."""
    return content.startswith(b"\x89PNG") and content[24] == 16 and mode in {"RGB", "RGBA", "LA"}


def _exif_time(exif: Any, name: str) -> tuple[np.datetime64, str, float | None]:
    """Return mid-exposure as EXIF has it."""
    block = exif.get_ifd(_EXIF_BLOCK)
    exposure = _positive(block.get(_EXIF_EXPOSURE))
    text = str(block.get(_EXIF_TIME, "")).strip("\0 ")
    if not re.fullmatch(r"\d{4}:\d\d:\d\d \d\d:\d\d:\d\d", text):
        return np.datetime64("NaT", "us"), "", exposure
    part = re.sub(r"\D", "", str(block.get(_EXIF_PART, "")))[:6]
    start = np.datetime64(f"{text[:10].replace(':', '-')}T{text[11:]}{'.' + part if part else ''}", "us")
    offset = re.fullmatch(r"([+-])(\d\d):(\d\d)", str(block.get(_EXIF_OFFSET, "")).strip("\0 "))
    source = "EXIF"
    if offset is None:
        source = "EXIF, without an offset: assumed to be UTC"
    else:
        minutes = int(offset[2]) * 60 + int(offset[3])
        start -= np.timedelta64(minutes if offset[1] == "+" else -minutes, "m")
    return _middle(start, exposure, name), source, exposure


def _read_raw(content: bytes, name: str, sensor: Sensor, raw: ImageFormat, limits: ImageLimits) -> Image:
    """Read numbers without a header."""
    if raw.bits is None:
        raise RefusedInputError(
            f"{name} contains raw numbers of unknown bit depth: give --raw-bits, or `image.bits` in the sensor file."
        )
    pixels = sensor.rows * sensor.columns
    _refuse_pixels(name, pixels, limits)
    width = 1 if raw.bits == 8 else 2
    expected = raw.header_bytes + width * pixels
    if len(content) != expected:
        raise RefusedInputError(
            f"{name} has {len(content):,} bytes; {sensor.rows:,} rows of {sensor.columns:,} numbers of {raw.bits} bits, {width} "
            f"byte{'s' * (width > 1)} each, after {raw.header_bytes:,} are {expected:,}: check size, --raw-bits and --raw-header."
        )
    kind = np.dtype(np.uint8 if width == 1 else np.uint16).newbyteorder("<" if raw.byte_order == "little" else ">")
    dn = np.frombuffer(content, kind, pixels, raw.header_bytes).reshape(sensor.rows, sensor.columns).astype(np.float64)
    white = float(2**raw.bits - 1)
    if dn.max() > white:
        other = "big" if raw.byte_order == "little" else "little"
        raise RefusedInputError(
            f"{name} contains {dn.max():,.0f}, more than {raw.bits} bits allow: check the byte order "
            f"(--raw-order {other})."
        )
    return Image(name, dn, hashlib.sha256(content).hexdigest(), np.datetime64("NaT", "us"), "", white_dn=white)


_READERS: Final = {"FITS": _read_fits, "PNG": _read_picture, "TIFF": _read_picture, "raw": _read_raw}


def _timed(image: Image, times: Mapping[str, np.datetime64] | None) -> Image:
    """Give an image the time that is believed first."""
    listed = None if times is None else times.get(image.name)
    if listed is not None:
        return replace(image, time_utc=listed, time_source="the list of times")
    if np.isnat(image.time_utc) and (named := time_in_name(image.name)) is not None:
        middle = _middle(named, image.exposure_s, image.name)
        return replace(image, time_utc=middle, time_source="the file's name, assumed to be UTC")
    return image


def time_in_name(name: str) -> np.datetime64 | None:
    """Return the time that a file's name holds, or None."""
    found = _NAMED_TIME.search(name)
    if found is None:
        return None
    year, month, day, hour, minute, second, part = found.groups()
    try:
        return np.datetime64(f"{year}-{month}-{day}T{hour}:{minute}:{second}.{(part or '0'):0<6}", "us")
    except ValueError:
        return None


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _short(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).splitlines()[0][:80] if str(error) else ''}".rstrip(": ")
