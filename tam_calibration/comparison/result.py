"""The result of a comparison: what a simulator's recording has otherwise than a real one, and the mend."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from tam_calibration.comparison.mend import Mend
from tam_calibration.comparison.side import Figure, Side
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Size
from tam_calibration.model.fitted_effect import FittedEffect

Verdict = Literal["same", "differs", "not_identifiable"]

UNKNOWN = "unknown"
"""In place of an effect's name: a part that no effect of the library explains."""


@dataclass(frozen=True)
class Mistake:
    """A gross mistake of a simulator, found before anything is fitted.

    Parameters
    ----------
    kind : str
        Such as "gauss_for_tesla": one word for programs.
    what : str
        The mistake in one sentence, in the words of simulators.
    where : str
        Such as "sensor 2, axis x", or "all sensors".
    mend : str
        What to change in the simulator, in one sentence.
    """

    kind: str
    what: str
    where: str
    mend: str


@dataclass(frozen=True, eq=False)
class NoiseDifference:
    """The noise of an axis in the simulation and in the recording."""

    simulation: AxisNoise
    recording: AxisNoise
    differs: bool


@dataclass(frozen=True, eq=False)
class EffectDifference:
    """An effect that one side has and the other has not.

    Parameters
    ----------
    effect : str
        Its name, or ``UNKNOWN``.
    sensors, axes : tuple
        Numbers 1…K or "scalar"; "x", "y", "z".
    probability : float
        That it is there, calibrated on simulated recordings.
    size : float
        Root of the energy that it explains, in noise floors of the side that has it.
    is_shown_by_other_run : bool
        Whether the run of the other side could have shown it.
    fitted : FittedEffect, optional
        Its parameters with standard errors, SI; None when it is unknown.
    units : mapping of str to str
        SI unit of each of them.
    """

    effect: str
    sensors: tuple[int | str, ...]
    axes: tuple[str, ...]
    probability: float
    size: float
    is_shown_by_other_run: bool
    fitted: FittedEffect | None = None
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class OtherParameters:
    """An effect that both sides have, with parameters that differ by more than their errors."""

    simulation: EffectDifference
    recording: EffectDifference


@dataclass(frozen=True)
class Step:
    """The gap once one more term was added to the simulation, or taken from it.

    Parameters
    ----------
    added : str
        What, in words.
    left : float
        Gap that is then left, noise floors.
    """

    added: str
    left: float


@dataclass(frozen=True)
class SourceError:
    """How far from a magnetic source that was put into a recording ``tam locate`` finds it.

    Parameters
    ----------
    median_m : float
        Median distance of the samples' sources from the true one, metres.
    interval_m : (float, float)
        95 % confidence interval of it, from blocks of time.
    """

    median_m: float
    interval_m: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Closing(Size):
    """How far the gap shrinks when the simulation is mended, out of sample: ``Size``, and what makes it up.

    The gap is that between simulation and recording, and between the mended twin of the simulation's run and the
    recording: root of the summed energies of what either has and the other has not, in noise floors.

    Parameters
    ----------
    steps : tuple of Step
        The gap after each term, the largest first.
    simulation_source, recording_source, mended_source : SourceError, optional
        Of the same source in the three; None where it cannot be located, as without attitude.
    left : str
        What stays open, and where; empty where nothing does.
    """

    steps: tuple[Step, ...] = ()
    simulation_source: SourceError | None = None
    recording_source: SourceError | None = None
    mended_source: SourceError | None = None
    left: str = ""

    @property
    def source_error_before_m(self) -> float:
        """How far the source error that the simulation predicts is from that in the recording, metres; else NaN."""
        return _apart(self.simulation_source, self.recording_source)

    @property
    def source_error_after_m(self) -> float:
        """The same of the mended twin."""
        return _apart(self.mended_source, self.recording_source)


def _apart(one: SourceError | None, other: SourceError | None) -> float:
    return float("nan") if one is None or other is None else abs(one.median_m - other.median_m)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of a simulator's recording with a real one.

    Parameters
    ----------
    verdict : str
        One of ``Verdict``: whether the simulation has all that the recording has, and nothing else. Errors of the
        sensors that a calibration removes do not count.
    statement : str
        The verdict in one sentence.
    mistakes : tuple of Mistake
        Of the simulator; where there are some, nothing else is compared.
    figures : tuple of Figure
        Side by side.
    missing, surplus : tuple of EffectDifference
        What the simulation lacks, and what it has beyond the recording; the largest first.
    other_parameters : tuple of OtherParameters
        What both have, with other parameters.
    noise : tuple of NoiseDifference
        Of each axis, and the scalar.
    closing : Closing, optional
        How far the gap shrinks; None where nothing was compared.
    mend : Mend, optional
        What to write into the simulator; None where nothing was compared.
    simulation, recording : Side, optional
        The two, for plots; None where nothing was compared.
    remarks : tuple of str
        To read before the verdict, one sentence each.

    Examples
    --------
    Two runs of one simulator differ in nothing; each has the noise of twelve axes and a scalar:

    >>> from dataclasses import replace
    >>> from tam_calibration import compare, read_scenario, simulate
    >>> scenario = read_scenario("wu_table_1")
    >>> one, other = (simulate(replace(scenario, seed=seed)).recording for seed in (1, 2))
    >>> comparison = compare(one, other, scenario.array)
    >>> comparison.verdict, comparison.missing, comparison.surplus, len(comparison.noise)
    ('same', (), (), 13)
    """

    verdict: Verdict
    statement: str
    mistakes: tuple[Mistake, ...] = ()
    figures: tuple[Figure, ...] = ()
    missing: tuple[EffectDifference, ...] = ()
    surplus: tuple[EffectDifference, ...] = ()
    other_parameters: tuple[OtherParameters, ...] = ()
    noise: tuple[NoiseDifference, ...] = ()
    closing: Closing | None = None
    mend: Mend | None = None
    simulation: Side | None = field(default=None, repr=False)
    recording: Side | None = field(default=None, repr=False)
    remarks: tuple[str, ...] = ()

    @property
    def laws_of_one(self) -> dict[str, tuple[Signature, ...]]:
        """The laws that the recording has and the simulation lacks, by the name of the side, and the reverse."""
        if self.simulation is None or self.recording is None:
            return {}
        own, theirs = self.recording.gap.signature, self.simulation.gap.signature
        return {"recording": _without(theirs, own), "simulation": _without(own, theirs)}


def _without(others: tuple[Signature, ...], laws: tuple[Signature, ...]) -> tuple[Signature, ...]:
    """Return the laws of which the others have none at a common sensor."""
    known = {(one.law, sensor) for one in others for sensor in one.sensors}
    return tuple(law for law in laws if known.isdisjoint((law.law, sensor) for sensor in law.sensors))
