"""A table read back, held against the table that was sent: which bytes differ, which bits of them, and in which field.

With e the bytes that were sent and d those of the dump, the bits that differ are those set in e XOR d. Bits are counted as
the table's fields are, the highest of a byte first, and named with their mask besides, for there are two customs: bit 3 of
a byte is the mask 0x10. A bit belongs to the field that covers it, to the stored CRC, or to the fill between them.

A dump is damaged, or something else was loaded: the CRC that the dump stores, held against the dump's own bytes, tells the
two apart. A CRC that holds belongs to other values; one that does not belongs to bytes that were altered after it was made.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from boresight.uplink.fields import Field
from boresight.uplink.table_definition import DecodedField, TableDefinition, decode

BITS_A_BYTE = 8
FILL = "fill"
LISTED_BYTES = 256  # of the differing ones in a document; all are counted, and every field is named
NAMED = 3  # differing fields or bytes that a sentence names


@dataclass(frozen=True)
class DifferingByte:
    """A byte of the dump that is not the one that was sent."""

    offset: int
    expected: int
    found: int
    fields: tuple[str, ...]

    @property
    def bits(self) -> tuple[int, ...]:
        """The bits that differ, the highest of a byte being bit 0."""
        return _set_bits(self.expected ^ self.found)

    @property
    def sentence(self) -> str:
        """Name the bits, the byte and the field: `bit 3 of byte 17 (mask 0x10), in f_m`."""
        numbers = ", ".join(map(str, self.bits))
        named = "all bits" if len(self.bits) == BITS_A_BYTE else f"bit{'s' * (len(self.bits) > 1)} {numbers}"
        mask = f"mask 0x{self.expected ^ self.found:02X}"
        return f"{named} of byte {self.offset} ({mask}), in {' and '.join(self.fields)}"

    def document(self) -> dict[str, Any]:
        """Write it as JSON."""
        return {
            "offset": self.offset,
            "expected_hex": f"{self.expected:02X}",
            "found_hex": f"{self.found:02X}",
            "bits": list(self.bits),
            "fields": list(self.fields),
        }


@dataclass(frozen=True)
class DifferingField:
    """A field of the dump that does not hold what was sent."""

    expected: DecodedField
    found: DecodedField

    def document(self) -> dict[str, Any]:
        """Write it as JSON: NaN and infinity, which JSON has no numbers for, as words."""
        field = self.expected.field
        return {
            "name": field.name,
            "parameter": field.parameter,
            "offset_bytes": field.bit // BITS_A_BYTE,
            "bit": field.bit,
            "bits": field.bits,
            "expected": _number(self.expected.value),
            "expected_hex": self.expected.hexadecimal,
            "found": _number(self.found.value),
            "found_hex": self.found.hexadecimal,
        }


@dataclass(frozen=True)
class DumpComparison:
    """What a dump says about the table that was sent."""

    length_bytes: int
    differing: tuple[DifferingByte, ...]
    fields: tuple[DifferingField, ...]
    crc_ok: bool | None

    @property
    def matches(self) -> bool:
        """Whether every byte is the one that was sent."""
        return not self.differing

    @property
    def sentence(self) -> str:
        """Say what was found, naming the first of what differs."""
        if self.matches:
            return f"All {self.length_bytes} bytes match what was sent."
        count = len(self.differing)
        named = "; ".join(one.sentence for one in self.differing[:NAMED])
        more = f"; and {count - NAMED} more" if count > NAMED else ""
        return f"{count} of {self.length_bytes} bytes differ{'s' * (count == 1)}: {named}{more}.{self._cause()}"

    def _cause(self) -> str:
        """Say what the dump's own CRC tells of the cause."""
        if self.crc_ok is None:
            return ""
        if self.crc_ok:
            return " The dump's own CRC matches: other values were loaded."
        return " The dump's own CRC does not match: the table was altered in memory or during downlink."

    def document(self) -> dict[str, Any]:
        """Write it as JSON."""
        return {
            "sentence": self.sentence,
            "length_bytes": self.length_bytes,
            "differing_bytes": len(self.differing),
            "bytes": [one.document() for one in self.differing[:LISTED_BYTES]],
            "fields": [one.document() for one in self.fields],
            "dump_crc_ok": self.crc_ok,
        }


def compare(definition: TableDefinition, expected: bytes, found: bytes) -> DumpComparison:
    """Hold a dump against the table that was sent.

    `expected`, `found`: (length_bytes,) bytes each.
    """
    sent, dumped = decode(definition, expected), decode(definition, found)
    fields = tuple(
        DifferingField(before, after)
        for before, after in zip(sent.fields, dumped.fields, strict=True)
        if before.hexadecimal != after.hexadecimal
    )
    return DumpComparison(len(expected), tuple(_differing(definition, expected, found)), fields, dumped.crc_ok)


def _differing(definition: TableDefinition, expected: bytes, found: bytes) -> Iterator[DifferingByte]:
    """Yield each byte that differs with the fields that its differing bits lie in."""
    for offset, (before, after) in enumerate(zip(expected, found, strict=True)):
        if before != after:
            bits = _set_bits(before ^ after)
            names = dict.fromkeys(_field_at(definition, BITS_A_BYTE * offset + bit) for bit in bits)
            yield DifferingByte(offset, before, after, tuple(names))


def _set_bits(mask: int) -> tuple[int, ...]:
    """Return which bits of a byte are set, the highest being bit 0."""
    return tuple(bit for bit in range(BITS_A_BYTE) if mask >> (BITS_A_BYTE - 1 - bit) & 1)


def _field_at(definition: TableDefinition, bit: int) -> str:
    """Return the name of the field that covers a bit of the table."""
    stored: tuple[Field, ...] = () if definition.crc_field is None else (definition.crc_field,)
    return next((field.name for field in (*definition.fields, *stored) if field.bit <= bit < field.end), FILL)


def _number(value: float) -> float | str:
    """Return a finite number as it is, and any other in words."""
    return value if math.isfinite(value) else str(value)
