"""What a telemetry file is: its bytes decide, and its suffix must agree with them."""

from __future__ import annotations

from pathlib import Path, PurePath

from boresight.errors import RefusedInputError

_PARQUET_MAGIC = b"PAR1"
_SUFFIXES = {".csv": "CSV", ".jsonl": "JSON Lines", ".ndjson": "JSON Lines", ".parquet": "Parquet"}
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_WORTH_THREADS_BYTES = 8_000_000


def worth_threads(data: bytes) -> bool:
    """Whether Arrow should read with its pool of threads.

    A small file gains nothing by it, and a process that a refusal ends while the pool is still starting aborts on its
    way out, once in some dozens of times on a busy machine.
    """
    return len(data) > _WORTH_THREADS_BYTES


def read_bytes(path: Path, name: str) -> bytes:
    """Return the content of a file.

    Parameters
    ----------
    path
        Where it is.
    name
        What refusals of its content call it.

    Raises
    ------
    RefusedInputError
        When there is no such file, it is a folder, it cannot be read, or it holds nothing.
    """
    if path.is_dir():
        raise RefusedInputError(f"{path} is a folder: name the telemetry file inside it.")
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise RefusedInputError(f"{path} does not exist: check the name.") from error
    except OSError as error:
        raise RefusedInputError(f"{path} cannot be read ({error.strerror}): check its permissions.") from error
    if not data:
        raise RefusedInputError(f"{name} is empty: download it again.")
    text = data.removeprefix(_BYTE_ORDER_MARK)
    if not text or text.isspace():
        raise RefusedInputError(f"{name} holds nothing but blanks: download it again.")
    return data


def format_of(name: str, data: bytes) -> str:
    """Return `CSV`, `JSON Lines` or `Parquet`.

    A file without one of the known suffixes is what its bytes are; content-addressed files have no suffix.

    Raises
    ------
    RefusedInputError
        When the suffix promises something else than the bytes hold.
    """
    if _is_wide_text(data):
        raise RefusedInputError(f"{name} is UTF-16 or UTF-32 text: save it as UTF-8.")
    found = _sniff(data)
    promised = _SUFFIXES.get(PurePath(name).suffix.lower(), found)
    if promised != found:
        raise RefusedInputError(
            f"{name} is named as {promised} but its content looks like {found}: rename it or export it again."
        )
    if found not in _SUFFIXES.values():
        raise RefusedInputError(f"{name} holds {found}: export it as CSV, JSON Lines or Parquet.")
    return found


def text_of(name: str, data: bytes) -> bytes:
    """Return the text of a file as UTF-8 with plain line ends, without byte-order mark and closing blank lines.

    Raises
    ------
    RefusedInputError
        When it is not UTF-8.
    """
    data = data.removeprefix(_BYTE_ORDER_MARK)
    if not data.isascii():
        _refuse_other_encodings(name, data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data[: _end_of_last_row(data)]


def blank_rows(text: bytes) -> list[int]:
    """Return the numbers of the rows that hold nothing, counted as an editor does."""
    if b"\n\n" not in text and not text.startswith(b"\n"):
        return []
    return [number for number, line in enumerate(text.split(b"\n"), start=1) if not line]


def _end_of_last_row(data: bytes) -> int:
    """Return where the last row ends that is not blank."""
    end = len(data)
    while (line := data.rfind(b"\n", 0, end)) >= 0 and not data[line:end].strip():
        end = line
    return end


def _is_wide_text(data: bytes) -> bool:
    """Say whether every other byte is zero, as ASCII is written in UTF-16 and UTF-32, or such a mark comes first."""
    return data.startswith(_UTF16_MARKS) or (len(data) > 3 and (not any(data[:64:2]) or not any(data[1:64:2])))


def _refuse_other_encodings(name: str, data: bytes) -> None:
    """Refuse bytes that are not UTF-8, naming the row of the first."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        row = data.count(b"\n", 0, error.start) + 1
        byte = data[error.start]
        raise RefusedInputError(
            f"{name}: row {row}: the byte 0x{byte:02x} is not UTF-8 (Latin-1 or Windows text?): save it as UTF-8."
        ) from error


def _sniff(data: bytes) -> str:
    """Say what the bytes look like."""
    if data.startswith(_PARQUET_MAGIC):
        return "Parquet"
    if data.startswith(b"PK\x03\x04"):
        return "a ZIP archive or a spreadsheet"
    if data.startswith(b"\x1f\x8b"):
        return "gzip-compressed data"
    if b"\0" in data[:4096]:
        return "binary data"
    start = data[:4096].removeprefix(_BYTE_ORDER_MARK).lstrip()
    if start.startswith((b"{", b"[")):
        return "JSON Lines"
    return "CSV"
