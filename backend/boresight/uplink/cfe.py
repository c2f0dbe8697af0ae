"""The file in which cFE Table Services take a table: two headers, big-endian on every target, and the image.

========  =====  ==============  ==========================================================
offset    bytes  field           content
========  =====  ==============  ==========================================================
0         4      ContentType     `cFE1`
4         4      SubType         8, a table image
8         4      Length          64, of this header
12        12     SpacecraftID, ProcessorID, ApplicationID
24        8      TimeSeconds, TimeSubSeconds: zero, for a file that is made again must be the same file
32        32     Description     text, ended by zeros
64        4      Reserved        0
68        4      Offset          first byte of the table that is loaded
72        4      NumBytes        how many
76        40     TableName       `APPLICATION.Table`, ended by zeros
========  =====  ==============  ==========================================================

Source: `CFE_FS_Header_t` and `CFE_TBL_File_Hdr_t` of cFE, and the loader's checks of them. A mission can give table names
another room than 40 bytes. A dump to a file comes back with the same two headers; `table_image` takes them off.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.uplink.definition_entries import Entries

CONTENT_TYPE = b"cFE1"
TABLE_IMAGE = 8
PRIMARY_BYTES = 64
KEYS = ("table_name", "table_name_bytes", "description", "spacecraft_id", "processor_id", "application_id")
LONGEST_DESCRIPTION = 31
LARGEST_ID = 2**32 - 1


@dataclass(frozen=True)
class CfeHeaders:
    """What a mission writes into the headers."""

    table_name: str
    table_name_bytes: int
    description: str
    spacecraft_id: int
    processor_id: int
    application_id: int

    @property
    def header_bytes(self) -> int:
        """Size of both headers."""
        return PRIMARY_BYTES + 12 + self.table_name_bytes


def parse_cfe(document: Any, faults: Faults) -> CfeHeaders | None:
    """Read the headers of a table definition; None where it has none."""
    if document is None:
        return None
    entries = Entries(document, "cfe", KEYS, faults)
    room = entries.whole("table_name_bytes", 16, 256, 40)
    return CfeHeaders(
        table_name=entries.ascii_text("table_name", room - 1),
        table_name_bytes=room,
        description=entries.ascii_text("description", LONGEST_DESCRIPTION, ""),
        spacecraft_id=entries.whole("spacecraft_id", 0, LARGEST_ID, 0),
        processor_id=entries.whole("processor_id", 0, LARGEST_ID, 0),
        application_id=entries.whole("application_id", 0, LARGEST_ID, 0),
    )


def table_file(headers: CfeHeaders, image: bytes, title: str) -> bytes:
    """Put the headers before a table's image."""
    described = headers.description or title.encode("ascii", "replace").decode()
    primary = struct.pack(
        ">4s7I32s",
        CONTENT_TYPE,
        TABLE_IMAGE,
        PRIMARY_BYTES,
        headers.spacecraft_id,
        headers.processor_id,
        headers.application_id,
        0,
        0,
        described[:LONGEST_DESCRIPTION].encode(),
    )
    name = headers.table_name.encode().ljust(headers.table_name_bytes, b"\0")
    return primary + struct.pack(">3I", 0, 0, len(image)) + name + image


def table_image(headers: CfeHeaders | None, length_bytes: int, content: bytes) -> bytes:
    """Return the image inside a dump: the dump itself, or what follows the headers of a cFE file."""
    if headers is None or len(content) == length_bytes or not content.startswith(CONTENT_TYPE):
        return content
    if len(content) < headers.header_bytes:
        raise RefusedInputError(f"The cFE file ends after {len(content)} bytes, inside its headers: dump it again.")
    _, start, size = struct.unpack(">3I", content[PRIMARY_BYTES : PRIMARY_BYTES + 12])
    name = content[PRIMARY_BYTES + 12 : headers.header_bytes].split(b"\0")[0].decode("ascii", "replace")
    image = content[headers.header_bytes :]
    if name != headers.table_name:
        raise RefusedInputError(f"The cFE file is of the table {name!r}, not of {headers.table_name}: give its dump.")
    if start != 0 or size != length_bytes or len(image) != length_bytes:
        raise RefusedInputError(
            f"The cFE file contains {len(image)} bytes and says {size} from byte {start}, expected all {length_bytes} "
            f"of {name}: dump the whole table."
        )
    return image
