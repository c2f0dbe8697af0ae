"""Entries of a table definition, its CRC among them, read one by one; what is wrong is noted with its place."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from typing import Any

from boresight.telemetry.read.checks import Faults
from boresight.uplink.checksum import CHECKED, CHECKSUMS, WIDTHS, Checksum
from boresight.uplink.fields import get_bits
from boresight.wording import quote

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
LONGEST_TEXT = 64
MOST_BYTES = 16384  # cFE's own limit of one table, unless a mission raises it
LARGEST = 2.0**64


class Entries:
    """The entries of one object of the definition."""

    def __init__(self, document: Any, place: str, known: tuple[str, ...], faults: Faults) -> None:
        self.place = place
        self.faults = faults
        self.document: Mapping[str, Any] = document if isinstance(document, Mapping) else {}
        if not isinstance(document, Mapping):
            faults.add(f"{place} is not an object: write names and values in braces")
        for key in self.document:
            if key not in known:
                meant = difflib.get_close_matches(str(key), known, 1, 0.6)
                hint = f"write {meant[0]}" if meant else f"choose from {', '.join(known)}"
                faults.add(f"{self._at(str(key))} is not an entry of a table definition: {hint}")

    def _at(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def _wrong(self, key: str, expected: str) -> None:
        if key in self.document:
            self.faults.add(f"{self._at(key)} is {quote(self.document[key])}: {expected}")
        else:
            self.faults.add(f"{self._at(key)} is missing: {expected}")

    def has(self, key: str) -> bool:
        """Whether the entry is given."""
        return key in self.document

    def text(self, key: str) -> str:
        """Return a printable text of 1 to 64 characters."""
        value = self.document.get(key)
        if isinstance(value, str) and value.strip() == value and 0 < len(value) <= LONGEST_TEXT and value.isprintable():
            return value
        self._wrong(key, f"write a text of 1 to {LONGEST_TEXT} printable characters")
        return ""

    def name(self, key: str) -> str:
        """Return a name that ground systems accept."""
        value = self.document.get(key)
        if isinstance(value, str) and NAME.fullmatch(value):
            return value
        self._wrong(key, "write a letter and up to 63 letters, digits and underscores")
        return ""

    def ascii_text(self, key: str, longest: int, default: str | None = None) -> str:
        """Return a printable ASCII text that leaves room for the zero that ends it in C."""
        value = self.document.get(key, default)
        written = isinstance(value, str) and value.isascii() and value.isprintable() and len(value) <= longest
        if written and (value or default == ""):
            return str(value)
        self._wrong(key, f"write up to {longest} ASCII characters")
        return ""

    def word(self, key: str, words: tuple[str, ...], default: str) -> str:
        """Return one of some words."""
        value = self.document.get(key, default)
        if isinstance(value, str) and value in words:
            return value
        self._wrong(key, f"choose {' or '.join(words)}")
        return default

    def optional_word(self, key: str, words: tuple[str, ...]) -> str | None:
        """Return one of some words, or None where it is left out."""
        if key not in self.document:
            return None
        return self.word(key, words, "") or None

    def kind(self, key: str) -> str:
        """Return the type of a field."""
        value = self.document.get(key)
        if isinstance(value, str) and get_bits(value):
            return value
        self._wrong(key, "choose float32, float64, or int<n> or uint<n> of 1 to 64 bits")
        return "uint8"

    def whole(self, key: str, low: int, high: int, default: Any = ...) -> Any:
        """Return a whole number between two limits; the default where it is left out."""
        if key not in self.document and default is not ...:
            return default
        value = self.document.get(key)
        if type(value) is int and low <= value <= high:
            return value
        self._wrong(key, f"give a whole number from {low} to {high}")
        return low

    def number(self, key: str, default: float) -> float:
        """Return a finite number; the default where it is left out."""
        value = self.document.get(key, default)
        if (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and abs(value) <= 1e30
            and math.isfinite(value)
        ):
            return float(value)
        self._wrong(key, "give a finite number")
        return default

    def constant(self, key: str) -> float:
        """Return a number as it is written, so that a whole one keeps every digit."""
        value = self.document.get(key)
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST:
            return value
        self._wrong(key, "give the constant number of the field, or name a parameter")
        return 0

    def bits_word(self, key: str, width: int) -> int:
        """Return a number of so many bits, written as `0x1021` or as a whole number."""
        value = self.document.get(key)
        if isinstance(value, str) and re.fullmatch(r"0[xX][0-9A-Fa-f]{1,16}", value):
            value = int(value, 16)
        if type(value) is int and 0 <= value < 1 << width:
            return value
        self._wrong(key, f"give a number of {width} bits, such as 0x1021")
        return 0

    def flag(self, key: str) -> bool:
        """Return true or false."""
        value = self.document.get(key)
        if isinstance(value, bool):
            return value
        self._wrong(key, "write true or false")
        return False

    def position(self) -> int:
        """Return the first bit of a field from `offset_bytes` or `offset_bits`."""
        if self.has("offset_bytes") == self.has("offset_bits"):
            self.faults.add(f"{self.place} needs offset_bytes or offset_bits: give one of them")
            return 0
        if self.has("offset_bits"):
            return int(self.whole("offset_bits", 0, 8 * MOST_BYTES))
        return 8 * int(self.whole("offset_bytes", 0, MOST_BYTES))


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
        faults.add(
            f"crc.name is not a known CRC: choose {', '.join(CHECKSUMS)}, or give {', '.join(PARAMETERS)} as well"
        )
        crc = next(iter(CHECKSUMS.values()))
    else:
        crc = _parsed(entries, faults)
        if known is not None and not faults.count and crc != known:
            faults.add(f"crc is called {known.name} but has other parameters: correct or omit them")
    if entries.has("check") and not faults.count:
        check = entries.bits_word("check", crc.width)
        if check != crc.value(CHECKED):
            faults.add(
                f"crc.check is {crc.text(check)}, but these parameters make {crc.text(crc.value(CHECKED))} "
                f"of {CHECKED.decode()}: correct them"
            )
    return crc, entries


def _parsed(entries: Entries, faults: Faults) -> Checksum:
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
