"""An address as a QR code in the terminal, for the camera of a phone."""

import segno

QUIET_ZONE = 2
"""Width of the margin, in modules; readers of today need no more."""
BLOCKS = {(0, 0): "█", (0, 1): "▀", (1, 0): "▄", (1, 1): " "}
"""Two modules, one above the other, as a character. The bright ones are drawn, since terminals are
mostly dark; readers take either."""


def qr_code(text: str, width: int) -> list[str]:
    """Return a QR code as lines; none if it is wider than `width` characters."""
    code = segno.make_qr(text, error="l")
    rows = [[int(dark) for dark in row] for row in code.matrix_iter(border=QUIET_ZONE)]
    columns = len(rows[0])
    if columns > width:
        return []
    if len(rows) % 2:
        rows.append([0] * columns)
    return [
        "".join(BLOCKS[pair] for pair in zip(upper, lower, strict=True))
        for upper, lower in zip(rows[::2], rows[1::2], strict=True)
    ]
