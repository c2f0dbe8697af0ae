"""Files that are neither telemetry nor JSON, recognised by the signature that their first bytes carry.

People bring the image, the archive or the workbook they have. A signature tells which it is whatever its name, so the refusal
says what the file is and what to make of it instead of complaining of its encoding.
"""

from __future__ import annotations

from typing import NamedTuple

from boresight.errors import RefusedInputError

#: A tape archive names itself here.
_TAR_OFFSET = 257
#: Enough of a ZIP archive for the names of its first members.
_FIRST_MEMBERS_BYTES = 4096

_CENTROIDS = (
    "Boresight reads star centroids, not images; find the stars with a centroiding program and write one row a star "
    "(frame, exposure, row_px, col_px) as CSV, JSON Lines or Parquet"
)
_UNPACK = "unpack it and give the CSV, JSON Lines or Parquet file inside"
_SAVE_SHEET = "save the sheet as CSV and give that"
_EXPORT = "write its table of stars as CSV, JSON Lines or Parquet"
_OTHER_FILE = "give the telemetry itself, as CSV, JSON Lines or Parquet"


class Kind(NamedTuple):
    """What a file is, with its article, and what to make telemetry of it by."""

    name: str
    remedy: str


_IMAGES = {
    b"SIMPLE  =": "FITS",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"II+\0": "TIFF",
    b"MM\0+": "TIFF",
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"\0\0\0\x0cjP  \r\n\x87\n": "JPEG 2000",
    b"GIF87a": "GIF",
    b"GIF89a": "GIF",
}
_SIGNATURES = {
    **{magic: Kind(f"a {name} image", _CENTROIDS) for magic, name in _IMAGES.items()},
    b"\x1f\x8b": Kind("compressed by gzip", _UNPACK),
    b"BZh": Kind("compressed by bzip2", _UNPACK),
    b"\xfd7zXZ\0": Kind("compressed by xz", _UNPACK),
    b"\x28\xb5\x2f\xfd": Kind("compressed by Zstandard", _UNPACK),
    b"7z\xbc\xaf\x27\x1c": Kind("a 7-Zip archive", _UNPACK),
    b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": Kind("an old Office document, as Excel's .xls", _SAVE_SHEET),
    b"%PDF-": Kind("a PDF document", _OTHER_FILE),
    b"\x89HDF\r\n\x1a\n": Kind("an HDF5 file", _EXPORT),
    b"CDF\x01": Kind("a NetCDF file", _EXPORT),
    b"CDF\x02": Kind("a NetCDF file", _EXPORT),
    b"MATLAB 5.0 MAT-file": Kind("a MATLAB file", _EXPORT),
    b"\x93NUMPY": Kind("a NumPy array", _EXPORT),
    b"ARROW1\0\0": Kind("an Arrow (Feather) file", "write it as Parquet"),
    b"FEA1": Kind("a Feather file", "write it as Parquet"),
    b"ORC": Kind("an ORC file", "write it as Parquet"),
    b"Obj\x01": Kind("an Avro file", "write it as Parquet"),
    b"SQLite format 3\0": Kind("an SQLite database", _EXPORT),
    b"\x7fELF": Kind("a program (ELF)", _OTHER_FILE),
}
_ZIP = b"PK\x03\x04"
#: What the names of an archive's first members say it is.
_ZIP_MEMBERS = {
    b"xl/": Kind("an Excel workbook", _SAVE_SHEET),
    b"opendocument.spreadsheet": Kind("an OpenDocument spreadsheet", _SAVE_SHEET),
    b"[Content_Types].xml": Kind("an Office document, as an Excel workbook", _SAVE_SHEET),
    b".npy": Kind("an archive of NumPy arrays", _EXPORT),
}
_PARQUET = b"PAR1"


def detect_kind(head: bytes) -> Kind | None:
    """Say what a file is that is not telemetry, by its first bytes; None where no signature is known."""
    if head.startswith(_ZIP):
        members = head[:_FIRST_MEMBERS_BYTES]
        for word, kind in _ZIP_MEMBERS.items():
            if word in members:
                return kind
        return Kind("a ZIP archive", f"{_UNPACK}, or save a spreadsheet as CSV")
    if head[_TAR_OFFSET : _TAR_OFFSET + 5] == b"ustar":
        return Kind("a tar archive", _UNPACK)
    for magic, kind in _SIGNATURES.items():
        # a text may well begin as a short signature does, a binary file is not text for long
        if head.startswith(magic) and not (magic.isalnum() and _is_text(head)):
            return kind
    return None


def refuse_other_kinds(name: str, head: bytes) -> None:
    """Refuse a file that cannot be telemetry, by its first bytes."""
    if (kind := detect_kind(head)) is not None:
        raise RefusedInputError(f"{name} is {kind.name}: {kind.remedy}.")


def refuse_no_json(name: str, head: bytes) -> None:
    """Refuse a file that is known to be no JSON text, by its first bytes."""
    kind = Kind("a Parquet file", "") if head.startswith(_PARQUET) else detect_kind(head)
    if kind is not None:
        raise RefusedInputError(f"{name} is {kind.name}, where a JSON text is expected: give the JSON file.")


def _is_text(head: bytes) -> bool:
    """Whether bytes could go on as text: no control characters but line ends and tabs, and UTF-8 but for a cut at the end."""
    if any(byte < 0x20 and byte not in b"\t\n\r" for byte in head):
        return False
    try:
        head[: max(len(head) - 3, 0)].decode()
    except UnicodeDecodeError as error:
        return error.reason == "unexpected end of data"
    return True
