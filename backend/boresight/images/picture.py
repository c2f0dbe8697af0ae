"""An image to look at: stretched to grey, and with its stars, matches and residuals over it as SVG."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import dataclass

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray

PICTURE_QUANTILES = (0.02, 0.998)
PICTURE_GAMMA = 0.5
#: A star's ring, px of the image's width.
RING_SHARE = 1.0 / 160.0
#: The longest residual is drawn as this share of the width.
LONGEST_SHARE = 0.05
SCALES = tuple(step * 10**power for power in range(5) for step in (1, 2, 5))
COLOURS = {"matched": "#4dd2ff", "unmatched": "#ffb302", "residual": "#ff5c8a"}


@dataclass(frozen=True)
class StarsOfImage:
    """The stars of one image; arrays (n,).

    `star_id`: 0 where unmatched, None where nothing was matched. `d_row_px`, `d_col_px`: centroid less predicted place, NaN where
    there is none.
    """

    row_px: FloatArray
    col_px: FloatArray
    saturated: BoolArray
    star_id: IntArray | None = None
    d_row_px: FloatArray | None = None
    d_col_px: FloatArray | None = None


def make_picture(dn: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> bytes:
    """Return an image (rows, columns) as a grey PNG: dark is the sky, white what stands clear of it."""
    import PIL.Image  # noqa: PLC0415 - 30 ms

    low, high = np.quantile(dn[::2, ::2], PICTURE_QUANTILES)
    grey = np.clip((dn - low) / max(high - low, 1.0), 0.0, 1.0) ** PICTURE_GAMMA
    stream = io.BytesIO()
    PIL.Image.fromarray((255 * grey).astype(np.uint8)).save(stream, "PNG", compress_level=3)
    return stream.getvalue()


def draw_svg(dn: np.ndarray[tuple[int, int], np.dtype[np.float64]], stars: StarsOfImage, title: str) -> str:
    """Return an image (rows, columns) with its stars over it, a file that needs nothing else.

    Residuals point from the centroid to the predicted place, longer than life by the number in the words below the image.
    """
    rows, columns = dn.shape
    picture = base64.b64encode(make_picture(dn)).decode()
    ring, scale = RING_SHARE * columns, _choose_scale(stars, columns)
    words = html.escape(f"{title}: {_words(stars, scale)}")
    marks = [_mark(stars, k, ring, scale) for k in range(len(stars.row_px))]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-0.5 -0.5 {columns} {rows + 5 * ring:g}" font-family="sans-serif">',
            f"<title>{words}</title>",
            f'<rect x="-0.5" y="-0.5" width="{columns}" height="{rows + 5 * ring:g}" fill="#101418"/>',
            f'<image href="data:image/png;base64,{picture}" x="-0.5" y="-0.5" width="{columns}" height="{rows}"/>',
            *marks,
            f'<text x="{ring:g}" y="{rows + 3.3 * ring:g}" font-size="{2.4 * ring:g}" fill="#ffffff">{words}</text>',
            "</svg>\n",
        ]
    )


def _choose_scale(stars: StarsOfImage, columns: int) -> int:
    """Choose how much longer than life residuals are drawn."""
    if stars.d_row_px is None or stars.d_col_px is None or not np.isfinite(stars.d_row_px).any():
        return 1
    longest = float(np.nanquantile(np.hypot(stars.d_row_px, stars.d_col_px), 0.95))
    return max((one for one in SCALES if one * longest <= LONGEST_SHARE * columns), default=1)


def _words(stars: StarsOfImage, scale: int) -> str:
    said = f"{len(stars.row_px)} stars, {int(stars.saturated.sum())} saturated"
    if stars.star_id is None:
        return said
    return f"{said}, {int((stars.star_id > 0).sum())} matched; residuals enlarged {scale} times"


def _mark(stars: StarsOfImage, k: int, ring: float, scale: int) -> str:
    """Draw one star: a ring, dashed where it is saturated, and its residual."""
    x, y = stars.col_px[k], stars.row_px[k]
    number = 0 if stars.star_id is None else int(stars.star_id[k])
    colour = COLOURS["unmatched" if stars.star_id is not None and not number else "matched"]
    dashed = f' stroke-dasharray="{ring / 2:g}"' if stars.saturated[k] else ""
    name = f"HIP {number}" if number else "no star" if stars.star_id is not None else "star"
    drawn = (
        f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{ring:g}" fill="none" stroke="{colour}" stroke-width="{ring / 5:g}"{dashed}>'
        f"<title>{name}, row {y:.3f}, column {x:.3f}</title></circle>"
    )
    if stars.d_row_px is None or stars.d_col_px is None or not np.isfinite(stars.d_row_px[k]):
        return drawn
    end_x, end_y = x - scale * stars.d_col_px[k], y - scale * stars.d_row_px[k]
    line = f'<line x1="{x:.2f}" y1="{y:.2f}" x2="{end_x:.2f}" y2="{end_y:.2f}"'
    return f'{drawn}{line} stroke="{COLOURS["residual"]}" stroke-width="{ring / 4:g}"/>'
