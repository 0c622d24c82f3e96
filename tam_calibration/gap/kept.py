"""What was told of a base is told once: a search comes back to the same base and the same hypotheses."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from tam_calibration.gap.regression import Base

Asked = TypeVar("Asked")
Told = TypeVar("Told")


def kept(tell: Callable[..., Told]) -> Callable[..., Told]:
    """Keep what a function tells of a base and something else, as long as both are there.

    Parameters
    ----------
    tell : callable
        Of the base, of what is asked, and of what follows from the base.
    """
    known: WeakKeyDictionary[Base, WeakKeyDictionary[Any, Told]] = WeakKeyDictionary()

    @wraps(tell)
    def told(base: Base, asked: Any, *following: Any) -> Told:
        of_base = known.setdefault(base, WeakKeyDictionary())
        if asked not in of_base:
            of_base[asked] = tell(base, asked, *following)
        return of_base[asked]

    return told
