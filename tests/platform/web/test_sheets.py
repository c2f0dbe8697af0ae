"""A page with gaps is, filled, the page with these values in it: plain, and as one gzip stream."""

import zlib

from hypothesis import given
from hypothesis import strategies as st

from boresight.platform.web.response_cache import NAME_GAP, TOKEN_GAP, CompressedPage

GAPS = (TOKEN_GAP.encode(), NAME_GAP.encode())
PIECES = st.lists(st.one_of(st.sampled_from(GAPS), st.binary(max_size=300)), max_size=12)
VALUES = st.tuples(st.binary(max_size=200), st.one_of(st.binary(max_size=20), st.just(b"n" * 70_000)))


@given(pieces=PIECES, values=VALUES)
def test_a_filled_sheet_is_the_page_with_the_values_in_its_gaps(
    pieces: list[bytes], values: tuple[bytes, bytes]
) -> None:
    page = b"".join(pieces)
    wanted = b"".join(values[GAPS.index(piece)] if piece in GAPS else piece for piece in pieces)
    assert CompressedPage(page, GAPS, compressed=False).filled(values) == wanted
    reader = zlib.decompressobj(16 + zlib.MAX_WBITS)
    assert reader.decompress(CompressedPage(page, GAPS, compressed=True).filled(values)) + reader.flush() == wanted
    assert reader.eof
    assert not reader.unused_data


def test_a_page_is_compressed_as_well_as_without_gaps() -> None:
    page = b"<tr><td>run</td></tr>" * 2000 + GAPS[0] + b"<tr><td>run</td></tr>" * 2000
    assert len(CompressedPage(page, GAPS, compressed=True).filled((b"t", b"n"))) < 2 * len(zlib.compress(page, 5))
