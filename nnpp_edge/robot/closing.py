"""Things that are closed at the end of a ``with`` block."""

from typing import Self


class Closing:
    """Has a method `close`, which a ``with`` block calls at its end."""

    def close(self) -> None:
        """Give back what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """The object itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()
