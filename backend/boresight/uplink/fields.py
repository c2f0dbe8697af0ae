"""One field of a table on board: where its bits lie and how they stand for a number.

A field begins at a bit, counted from the table's first byte with the highest bit of a byte first, as ECSS and OpenC3 count.
Its raw value is a float32, a float64 or an integer of 1 to 64 bits, signed ones in two's complement, and the number is

    number = scale raw + offset,    raw = (number - offset) / scale, for an integer rounded half to even,

so that an integer with a scale is a fixed-point number, and a float with a scale holds another unit than SI. Little-endian
order reverses the bytes of a field, so it needs 8, 16, 32 or 64 bits from a whole byte on; every other field is big-endian. Floats
begin at a whole byte too.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass

from boresight.errors import RefusedInputError

FORMATS = {"float32": (32, "f"), "float64": (64, "d")}
INTEGER = re.compile(r"(u?)int([1-9][0-9]?)")
MOST_BITS = 64


def get_bits(kind: str) -> int | None:
    """Size of a type, bits; None when there is no such type."""
    if kind in FORMATS:
        return FORMATS[kind][0]
    match = INTEGER.fullmatch(kind)
    return int(match[2]) if match and int(match[2]) <= MOST_BITS else None


@dataclass(frozen=True)
class Field:
    """A number in the table.

    `bit`: Where it begins, bits from the start of the table.
    """

    name: str
    parameter: str | None
    bit: int
    kind: str
    little: bool = False
    scale: float = 1.0
    offset: float = 0.0
    constant: float | None = None
    alignment: str | None = None

    @property
    def bits(self) -> int:
        """Size, bits."""
        return get_bits(self.kind) or 0

    @property
    def end(self) -> int:
        """First bit after it."""
        return self.bit + self.bits

    @property
    def floating(self) -> bool:
        """Whether its raw value is a floating-point number."""
        return self.kind in FORMATS

    @property
    def unsigned(self) -> bool:
        """Whether its raw value is a count without a sign."""
        return self.kind.startswith("u")

    @property
    def plain(self) -> bool:
        """Whether the raw value is the number itself."""
        return (self.scale, self.offset) == (1.0, 0.0)

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest raw value."""
        if self.kind == "float32":
            largest = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0]
            return -largest, largest
        if self.kind == "float64":
            largest = math.nextafter(math.inf, 0.0)
            return -largest, largest
        return (0, (1 << self.bits) - 1) if self.unsigned else (-(1 << self.bits - 1), (1 << self.bits - 1) - 1)

    def pack(self, number: float) -> int:
        """Turn a number into the field's bits, highest first."""
        raw = number if self.plain else (number - self.offset) / self.scale
        low, high = self.limits
        if not math.isfinite(raw):
            raise self._refusal(number)
        if self.floating:
            try:
                bits = int.from_bytes(struct.pack(f">{FORMATS[self.kind][1]}", raw), "big")
            except OverflowError as error:
                raise self._refusal(number) from error
        else:
            count = round(raw)
            if not low <= count <= high:
                raise self._refusal(number)
            bits = count & ((1 << self.bits) - 1)
        return self._ordered(bits)

    def unpack(self, bits: int) -> tuple[float | int, float]:
        """Turn the field's bits, highest first, into the raw value and the number; NaN and infinity pass through."""
        bits = self._ordered(bits)
        raw: float | int
        if self.floating:
            raw = struct.unpack(f">{FORMATS[self.kind][1]}", bits.to_bytes(self.bits // 8, "big"))[0]
        else:
            negative = not self.unsigned and bits >> (self.bits - 1)
            raw = bits - (1 << self.bits) if negative else bits
        return raw, float(raw) if self.plain else self.scale * raw + self.offset

    def _ordered(self, bits: int) -> int:
        """Reverse the bytes of a little-endian field; once more gives the first again."""
        return int.from_bytes(bits.to_bytes(self.bits // 8, "big"), "little") if self.little else bits

    def _refusal(self, number: float) -> RefusedInputError:
        ends = sorted(self.scale * limit + self.offset for limit in self.limits)
        return RefusedInputError(
            f"{self.name} cannot hold {number!r}: a {self.kind} of scale {self.scale:g} and offset {self.offset:g} "
            f"reaches from {ends[0]:.6g} to {ends[1]:.6g}. Correct the table definition, or choose another set."
        )
