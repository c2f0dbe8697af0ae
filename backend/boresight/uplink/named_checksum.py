"""The CRC of a table definition: one of the known names, or a name of the mission's own with every parameter."""

from __future__ import annotations

from typing import Any

from boresight.telemetry.refusals import Faults
from boresight.uplink.checksum import CHECKED, CHECKSUMS, WIDTHS, Checksum
from boresight.uplink.definition_entries import Entries

PARAMETERS = ("width", "poly", "init", "refin", "refout", "xorout")
KEYS = ("name", *PARAMETERS, "check", "offset_bytes", "over", "byte_order")


def parse_checksum(document: Any, faults: Faults) -> tuple[Checksum, Entries]:
    """Read the algorithm; parameters that contradict a known name, or its check value, are faults."""
    entries = Entries(document, "crc", KEYS, faults)
    known = CHECKSUMS.get(str(entries.document.get("name")))
    given = [key for key in PARAMETERS if entries.has(key)]
    if known is not None and not given:
        crc = known
    elif not given:
        faults.add(f"crc.name is no known CRC: choose {', '.join(CHECKSUMS)}, or give {', '.join(PARAMETERS)} as well")
        crc = next(iter(CHECKSUMS.values()))
    else:
        crc = _parsed(entries, faults)
        if known is not None and not faults.count and crc != known:
            faults.add(f"crc is called {known.name} but has other parameters: correct them or leave them out")
    if entries.has("check") and not faults.count:
        check = entries.bits_word("check", crc.width)
        if check != crc.value(CHECKED):
            faults.add(
                f"crc.check is {crc.text(check)}, but these parameters make {crc.text(crc.value(CHECKED))} "
                f"of {CHECKED.decode()}: correct them"
            )
    return crc, entries


def _parsed(entries: Entries, faults: Faults) -> Checksum:
    """Read every parameter of an algorithm."""
    width = entries.whole("width", min(WIDTHS), max(WIDTHS))
    if width not in WIDTHS:
        faults.add(f"crc.width is {width}: choose {', '.join(map(str, WIDTHS))} bits")
        width = WIDTHS[0]
    return Checksum(
        name=entries.text("name"),
        width=width,
        poly=entries.bits_word("poly", width),
        init=entries.bits_word("init", width),
        refin=entries.flag("refin"),
        refout=entries.flag("refout"),
        xorout=entries.bits_word("xorout", width),
    )
