"""Cyclic redundancy checks, each named by all of its parameters, for two algorithms may share a name and no value.

The parameters are those of Williams' model ("A painless guide to CRC error detection algorithms", 1993), in which the
catalogue of parametrised CRC algorithms writes them too: width, poly, init, refin, refout, xorout, and `check`, the value of
the nine ASCII digits 123456789, which tells two parametrisations apart.

==================  =====  ==========  ==========  =====  ======  ==========  ==========================================
name                width  poly        init        refin  refout  xorout      who computes it
==================  =====  ==========  ==========  =====  ======  ==========  ==========================================
CRC-16/ARC          16     0x8005      0x0000      true   true    0x0000      cFE Table Services (CFE_ES_CrcType_16_ARC)
CRC-16/CCITT-FALSE  16     0x1021      0xFFFF      false  false   0x0000      CCSDS and PUS packet error control
CRC-32              32     0x04C11DB7  0xFFFFFFFF  true   true    0xFFFFFFFF  Ethernet, ZIP
==================  =====  ==========  ==========  =====  ======  ==========  ==========================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from crc import Calculator, Configuration

CHECKED = b"123456789"
WIDTHS = (8, 16, 24, 32, 64)


@dataclass(frozen=True)
class Checksum:
    """A CRC by its name and its parameters, `width` in bits, the others as Williams names them."""

    name: str
    width: int
    poly: int
    init: int
    refin: bool
    refout: bool
    xorout: int

    def value(self, content: bytes) -> int:
        """Compute the check value of some bytes."""
        return _value(self, content)

    def text(self, value: int) -> str:
        """Write a value in hexadecimal, with all its digits."""
        return f"0x{value:0{self.width // 4}X}"

    def document(self) -> dict[str, Any]:
        """Say which algorithm this is, beyond doubt: every parameter, and the value of `123456789`."""
        return {
            "name": self.name,
            "width": self.width,
            "poly": self.text(self.poly),
            "init": self.text(self.init),
            "refin": self.refin,
            "refout": self.refout,
            "xorout": self.text(self.xorout),
            "check": self.text(self.value(CHECKED)),
        }


@lru_cache(maxsize=64)
def _value(checksum: Checksum, content: bytes) -> int:
    """Compute a check value; kept, because one image is asked for it many times and the library takes some 20 µs a byte."""
    configuration = Configuration(
        width=checksum.width,
        polynomial=checksum.poly,
        init_value=checksum.init,
        final_xor_value=checksum.xorout,
        reverse_input=checksum.refin,
        reverse_output=checksum.refout,
    )
    return int(Calculator(configuration).checksum(content))


CHECKSUMS: dict[str, Checksum] = {
    checksum.name: checksum
    for checksum in (
        Checksum("CRC-16/ARC", 16, 0x8005, 0x0000, refin=True, refout=True, xorout=0x0000),
        Checksum("CRC-16/CCITT-FALSE", 16, 0x1021, 0xFFFF, refin=False, refout=False, xorout=0x0000),
        Checksum("CRC-32", 32, 0x04C11DB7, 0xFFFFFFFF, refin=True, refout=True, xorout=0xFFFFFFFF),
    )
}
