"""The largest sizes of effects in nature."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.units import to_nanotesla


@dataclass(frozen=True)
class Limit:
    """The largest size, in SI units, that a value of an effect has in nature, and the source that says so."""

    largest: float
    source: str
    unit: str = "1"

    def with_unit(self, value: float) -> str:
        """Return a value in this unit as people read it."""
        is_field = self.unit.startswith("T")
        number = np.format_float_positional(to_nanotesla(value) if is_field else value, 3, fractional=False, trim="-")
        return number if self.unit == "1" else f"{number} {'n' * is_field}{self.unit}"

    def excess(self, name: str, value: float) -> str | None:
        """Return that a value of some name is larger than any in nature, in one clause; None where it is not.

        Parameters
        ----------
        name : str
            Name of the value as in the clause.
        value : float
            In SI units; its sign does not count.
        """
        if abs(value) <= self.largest:
            return None
        size, known = self.with_unit(value), self.with_unit(self.largest)
        return f"its {name} of {size} is more than the {known} known ({self.source})"


@dataclass(frozen=True)
class Sized:
    """A value of a fitted effect by its name, the largest over its places, beside the largest in nature."""

    name: str
    value: float
    limit: Limit

    @property
    def excess(self) -> str | None:
        """That it is larger than any in nature, in one clause; None where it is not."""
        return self.limit.excess(self.name, self.value)
