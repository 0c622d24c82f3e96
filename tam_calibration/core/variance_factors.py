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

    def divided_by(self, divisor: float) -> "VarianceFactors":
        """Return both, smaller by a divisor."""
        return VarianceFactors(self.differential / divisor, self.common_mode / divisor)

    def exceed(self, others: "VarianceFactors", part: float) -> bool:
        """Whether one of them is larger than the same of others by more than a part of that."""
        return (
            self.differential > (1 + part) * others.differential or self.common_mode > (1 + part) * others.common_mode
        )


WHITE = VarianceFactors()
"""Of white noise of the stated size."""
