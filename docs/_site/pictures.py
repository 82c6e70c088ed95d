"""The pictures of the gallery: `make pictures` runs the examples, and keeps what they draw as small WebP files."""

import sys
from importlib import import_module
from pathlib import Path

from PIL import Image, ImageSequence

DOCS = Path(__file__).parent.parent
EXAMPLES = DOCS.parent / "examples"
MOST_PIXELS = 1000


def shrunk(picture: Path, target: Path) -> None:
    """Keep a picture, or each frame of a film, as WebP of at most so many pixels a side."""
    with Image.open(picture) as image:
        factor = min(1.0, MOST_PIXELS / max(image.size))
        size = (round(image.width * factor), round(image.height * factor))
        durations = [frame.info.get("duration", 0) for frame in ImageSequence.Iterator(image)]
        frames = [frame.convert("RGB").resize(size) for frame in ImageSequence.Iterator(image)]
    more = {"save_all": True, "append_images": frames[1:], "duration": durations, "loop": 0} if frames[1:] else {}
    frames[0].save(target, quality=55 if more else 78, method=6, **more)


if __name__ == "__main__":
    sys.path.insert(0, str(EXAMPLES))
    (EXAMPLES / "out").mkdir(exist_ok=True)
    names = sys.argv[1:]
    for path in sorted(EXAMPLES.glob("*.py")):
        if path.stem != "drawing" and (not names or path.stem in names):
            shrunk(import_module(path.stem).main(EXAMPLES / "out"), DOCS / "gallery" / f"{path.stem}.webp")
