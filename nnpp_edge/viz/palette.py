"""The colours of all pictures, which people with any colour vision tell apart: those of Okabe and
Ito (2008) and of Tol (2021), and greys.

They are written as matplotlib and pages do.
"""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green, blue, 0 to 255."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


INK = "#1e1e1e"
PAPER = "#fafafa"
START = "#f0e442"
GOAL = "#cc79a7"
PATH = "#d55e00"
OPTIMUM = INK
DRIVEN = "#009e73"
GRID = "#ffe9a8"
POINT = "#ffffff"
BODY = "#000000"
SEEN = "#56b4e9"
ENDED = "#d55e00"

# areas, laid over the relief
COST = "#9c6b1e"
IMPASSABLE = "#33231d"
UNKNOWN = "#8c8c8c"
REGION = "#0072b2"
REACHED = "#009e73"
REFUSED: tuple[tuple[str, str], ...] = (
    ("#56b4e9", "unknown ground, obstacle or edge"),
    ("#882255", "too steep"),
    ("#e69f00", "too steep ahead"),
    ("#332288", "too steep sideways"),
    ("#999933", "rock under a wheel"),
    ("#117733", "ground touches the belly"),
)
"""Colour, and words of the legend, of ground where a limit refuses a vehicle, by its place in
`REFUSALS`.
"""
