"""What recursions hold from one batch of samples to the next: the state of a lag, the places of plays."""

from typing import Any


class Memory:
    """The last values of the recursions that the terms of an effect go through.

    They go through the same recursions in the same order for every batch, so that these need no names: each recalls
    what it kept at the end of the batch before, and keeps what it needs at the start of the next.
    """

    def __init__(self) -> None:
        self._kept: list[Any] = []
        self._turn = 0

    def rewind(self) -> None:
        """Begin a batch: the first recursion has its turn."""
        self._turn = 0

    def recall(self) -> Any:
        """Return what the recursion whose turn it is kept of the batch before; None in the first batch."""
        return self._kept[self._turn] if self._turn < len(self._kept) else None

    def keep(self, value: Any) -> None:
        """Keep a value for the next batch, and give the turn to the next recursion."""
        self._kept[self._turn : self._turn + 1] = [value]
        self._turn += 1
