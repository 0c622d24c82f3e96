"""By how much the variance of what each channel of the likelihood tells exceeds that of white noise."""

from dataclasses import dataclass


@dataclass(frozen=True)
class VarianceFactors:
    """Variance of the scores of each channel over that which white noise of the stated size gives them.

    Parameters
    ----------
    differential : float
        Of the channels between the sensors; 1 or more.
    common_mode : float
        Of the intensity against its reference; 1 or more.
    """

    differential: float = 1.0
    common_mode: float = 1.0

    @property
    def largest(self) -> float:
        """The larger of both."""
        return max(self.differential, self.common_mode)

    def at_least(self, others: "VarianceFactors") -> "VarianceFactors":
        """Return the larger of each two."""
        return VarianceFactors(max(self.differential, others.differential), max(self.common_mode, others.common_mode))

    def times(self, multiple: float) -> "VarianceFactors":
        """Return a multiple of both."""
        return VarianceFactors(self.differential * multiple, self.common_mode * multiple)

    def is_near(self, others: "VarianceFactors", part: float) -> bool:
        """Whether both differ from the same of others by no more than a part of those."""
        return (
            abs(self.differential - others.differential) <= part * others.differential
            and abs(self.common_mode - others.common_mode) <= part * others.common_mode
        )

    def exceed(self, others: "VarianceFactors", part: float) -> bool:
        """Whether one of them is larger than the same of others by more than a part of that."""
        return (
            self.differential > (1 + part) * others.differential or self.common_mode > (1 + part) * others.common_mode
        )


WHITE = VarianceFactors()
"""Of white noise of the stated size."""
