"""The colours of all pictures, which people with any colour vision tell apart: those of Okabe and
Ito (2008) and of Tol (2021), and greys.

They are blue, green, red, OpenCV's order.
"""

Colour = tuple[int, int, int]
"""Blue, green, red."""


def _of(code: str) -> Colour:
    red, green, blue = bytes.fromhex(code)
    return blue, green, red


def hexed(colour: Colour) -> str:
    """As matplotlib and pages write it."""
    return "#{2:02x}{1:02x}{0:02x}".format(*colour)


INK = _of("1e1e1e")
PAPER = _of("fafafa")
START = _of("f0e442")
GOAL = _of("cc79a7")
PATH = _of("d55e00")
OPTIMUM = INK
DRIVEN = _of("009e73")
GRID = _of("ffe9a8")
POINT = _of("ffffff")
BODY = _of("000000")
SEEN = _of("56b4e9")
ENDED = _of("d55e00")

# areas, laid over the relief
COST = _of("9c6b1e")
IMPASSABLE = _of("33231d")
UNKNOWN = _of("8c8c8c")
REGION = _of("0072b2")
REACHED = _of("009e73")
REFUSED: tuple[tuple[Colour, str], ...] = (
    (_of("56b4e9"), "unknown ground, obstacle or edge"),
    (_of("882255"), "too steep"),
    (_of("e69f00"), "too steep ahead"),
    (_of("332288"), "too steep sideways"),
    (_of("999933"), "rock under a wheel"),
    (_of("117733"), "ground touches the belly"),
)
"""Colour, and words of the legend, of ground where a limit refuses a vehicle, by its place in
`REFUSALS`.
"""
