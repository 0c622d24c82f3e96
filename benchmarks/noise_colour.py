"""How well level and colour of the noise of every axis are found, and when two noises are said to differ.

Run ``python benchmarks/noise_colour.py [--runs 20]``. Four sensors, whose residuals against their mean mix the noises
of their twelve axes; one sensor has a coloured part of a given variance beside white noise of one, that at the
frequencies of the run. Figures, in per cent: rows of right colour, of the coloured sensor and of the others, levels
within 5 % of that of the noise that was drawn, and pairs of runs of which any row is said to differ. White noise is
drawn five times as often.
"""

from dataclasses import dataclass

import click
import numpy as np
from asked import ANYTHING, Figure, show

from tam_calibration.comparison.agreement import differs
from tam_calibration.gap.noise import AxisNoise, noise_of
from tam_calibration.model.units import FloatArray

MIXING = np.kron(np.eye(4) - 0.25, np.eye(3))
"""Of four alike sensors less their mean."""

STEP_S = 0.02
"""Between samples: no figure depends on it, as kinds are given in cycles a sample."""

COUNTS = (400, 1000, 4000)
"""Samples: the fewest that tell a slow course, and those of a short and of a long run at sea."""

VARIANCES = (0.25, 0.5, 1.0, 4.0)
"""Of the coloured part over that of the white one: from where no colour can be told to where all should be."""


@dataclass(frozen=True)
class Kind:
    """A coloured noise by its density, from frequencies in cycles a sample, and the colour that it should be given."""

    name: str
    colour: str
    exponent: float = 0.0
    corner: float = 0.0
    half_width: float = 0.0
    centre: float = 0.0

    def density(self, frequency: FloatArray) -> FloatArray:
        """Return a power law, a relaxation, or a resonance."""
        if self.half_width:
            return 1 / (self.half_width**2 + (frequency - self.centre) ** 2)
        return (self.corner**2 + frequency**2) ** (-self.exponent / 2)

    def series(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Return noise whose variance within so many samples is one in the mean."""
        frequency = np.fft.rfftfreq(4 * count)
        amplitude = np.sqrt(self.density(np.maximum(frequency, frequency[1])))
        amplitude /= np.sqrt(np.mean(amplitude[4:] ** 2))
        drawn = np.fft.irfft(np.fft.rfft(generator.normal(size=4 * count)) * amplitude)[:count]
        return np.asarray(drawn - drawn.mean())


KINDS = (
    Kind("flicker 1/f", "1/f", exponent=1.0),
    Kind("f^-0.6", "1/f", exponent=0.6),
    Kind("random walk", "1/f", exponent=2.0),
    Kind("AR(1), corner at 0.02 of the rate", "1/f", exponent=2.0, corner=0.02),
    Kind("AR(1), corner at 0.1 of the rate", "1/f", exponent=2.0, corner=0.1),
    Kind("band of 2 % half width", "band", half_width=0.002, centre=0.1),
    Kind("band of 10 % half width", "band", half_width=0.01, centre=0.1),
    Kind("band of 20 % half width", "band", half_width=0.06, centre=0.3),
)
"""Both classes from steep to flat and from narrow to wide, so that the limits of each are seen."""


def run(
    kind: Kind | None, variance: float, count: int, generator: np.random.Generator
) -> tuple[FloatArray, tuple[AxisNoise, ...]]:
    """Return the noises that were drawn (N, 12), and what is found."""
    rows = generator.normal(size=(count, 12))
    if kind is not None:
        for row in range(3):
            rows[:, row] += np.sqrt(variance) * kind.series(count, generator)
    return rows, noise_of(STEP_S * np.arange(count), rows @ MIXING.T, MIXING)


def figures_of(kind: Kind | None, variance: float, count: int, runs: int, seed: int) -> list[Figure]:
    """Return the figures of so many pairs of runs."""
    generator = np.random.default_rng([seed, count])
    right, white, within, other = [], [], [], []
    for _ in range(runs):
        pair = [run(kind, variance, count, generator) for _ in range(2)]
        for rows, found in pair:
            right += [axis.colour == kind.colour for axis in found[:3]] if kind else []
            white += [axis.colour == "white" for axis in (found[3:] if kind else found)]
            levels = np.array([axis.level_T for axis in found]) / rows.std(axis=0)
            within += (np.abs(levels - 1) < 0.05).tolist()
        other.append(any(differs(*axes) for axes in zip(pair[0][1], pair[1][1], strict=True)))
    case = f"{kind.name}, {variance:g} of the white" if kind else "white"
    large = variance >= 1 and count >= 1000
    values = {
        "right colour": (right, (95.0, 100.0) if large else ANYTHING),
        "others white": (white, (99.0, 100.0)),
        "level within 5 %": (within, (95.0, 100.0) if count >= 1000 else ANYTHING),
        "equal runs differ": (other, ANYTHING if kind else (0.0, 1.0)),
    }
    return [
        Figure(case, f"{count} samples", f"{name} [%]", 100 * float(np.mean(each)), asked=asked)
        for name, (each, asked) in values.items()
        if each
    ]


@click.command(help=__doc__)
@click.option("--runs", default=20, show_default=True, help="Pairs of runs of each case.")
@click.option("--seed", default=1, show_default=True)
def main(runs: int, seed: int) -> None:
    """Run the benchmark."""
    cases: list[tuple[Kind | None, float]] = [(None, 1.0), *((kind, each) for kind in KINDS for each in VARIANCES)]
    figures = [
        figure
        for case in cases
        for count in COUNTS
        for figure in figures_of(*case, count, runs * (1 + 4 * (case[0] is None)), seed)
    ]
    show(figures, "Level and colour of noise", "length")


if __name__ == "__main__":
    main()
