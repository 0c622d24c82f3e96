"""What was told of a base is told once: a search comes back to the same base and the same hypotheses."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from tam_calibration.gap.regression import Base

Told = TypeVar("Told")


def kept(tell: Callable[..., Told]) -> Callable[..., Told]:
    """Keep what a function tells of a base, or of a base and something that is asked, as long as these are there."""
    known: WeakKeyDictionary[Base, WeakKeyDictionary[Any, Told]] = WeakKeyDictionary()

    @wraps(tell)
    def told(base: Base, *asked: Any) -> Told:
        of_base = known.setdefault(base, WeakKeyDictionary())
        key = asked[0] if asked else base
        if key not in of_base:
            of_base[key] = tell(base, *asked)
        return of_base[key]

    return told
