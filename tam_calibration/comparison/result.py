"""The result of a comparison: what a simulator's recording has otherwise than a real one, and the mend."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Gap, Size
from tam_calibration.gap.search_result import Search
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording

Verdict = Literal["same", "differs", "not_identifiable"]
Standing = Literal["same", "differs", "cannot tell"]

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


@dataclass(frozen=True)
class ReadingFigure:
    """A plain figure of one recording.

    Parameters
    ----------
    group, name : str
        Such as "stamps", "rate".
    unit : str
        SI unit; "1" for none.
    value : float
        NaN where the recording has none.
    standard_error : float
        NaN where it is not known.
    tolerance : float
        Difference that is none in practice, in the unit of the value.
    is_of_simulation : bool
        Whether a difference is one of the simulation; else it is of the path that was flown.
    """

    group: str
    name: str
    unit: str
    value: float
    standard_error: float = float("nan")
    tolerance: float = 0.0
    is_of_simulation: bool = True


CERTAIN = 4.5
"""Standard errors from which two figures differ: of some hundred by chance in one of a thousand comparisons."""


@dataclass(frozen=True)
class Figure:
    """One figure of the simulation and the same of the recording."""

    simulation: ReadingFigure
    recording: ReadingFigure

    @property
    def difference(self) -> float:
        """How far the two values are apart, in the unit of the figure."""
        return abs(self.recording.value - self.simulation.value)

    @property
    def standard_errors(self) -> float:
        """The recording's value less the simulation's, in standard errors of the difference; NaN where not known."""
        size = float(np.hypot(self.simulation.standard_error, self.recording.standard_error))
        return (self.recording.value - self.simulation.value) / size if size > 0 else float("nan")

    @property
    def standing(self) -> Standing:
        """Whether the two differ beyond tolerance and chance; what is of the path never does."""
        if not np.isfinite(self.difference):
            return "cannot tell"
        errors = np.nan_to_num([self.simulation.standard_error, self.recording.standard_error])
        chance = CERTAIN * float(np.hypot(errors[0], errors[1]))
        is_same = self.difference <= max(self.simulation.tolerance, self.recording.tolerance, chance)
        return "same" if is_same or not self.simulation.is_of_simulation else "differs"


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


@dataclass(frozen=True)
class NoiseTerm:
    """Noise of one axis that a simulation shall have, and what has to be added to what it has now.

    Parameters
    ----------
    sensor : int
        Number 1…K; 0 for the scalar.
    axis : str
        "x", "y", "z"; empty for the scalar.
    white_T : float
        Standard deviation of the white noise that it shall have.
    added_white_T : float
        Standard deviation of the white noise that is missing; 0 where it has too much.
    knee_hz, exponent : float
        Of the slow noise that it shall have and has not, in addition to the white noise ``white_T``; NaN without one.
    band_hz : (float, float), optional
        Of the band of noise that it shall have and has not.
    band_T : float
        Standard deviation in the band.
    """

    sensor: int
    axis: str
    white_T: float
    added_white_T: float
    knee_hz: float = float("nan")
    exponent: float = float("nan")
    band_hz: tuple[float, float] | None = None
    band_T: float = 0.0

    @classmethod
    def of(cls, noise: AxisNoise) -> "NoiseTerm":
        """Return all the noise of an axis as noise to add."""
        return cls(**{each.name: getattr(noise, each.name.removeprefix("added_")) for each in fields(cls)})


@dataclass(frozen=True, eq=False)
class Mend:
    """What to write into the simulator.

    Parameters
    ----------
    added : tuple of FittedEffect
        Effects that the simulation lacks, in the order of their sizes; their times are since the first sample of a run.
    removed : tuple of str
        Effects that it should not have, or have with the parameters of ``added``.
    noise : tuple of NoiseTerm
        Of every axis and the scalar.
    calibration : Calibration
        Of the recording: array, errors of the sensors, noise and all its effects.
    rate_hz : float
        Of the recording's samples.
    """

    added: tuple[FittedEffect, ...]
    removed: tuple[str, ...]
    noise: tuple[NoiseTerm, ...]
    calibration: Calibration
    rate_hz: float


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two recordings, and what the judge says of it.

    Parameters
    ----------
    recording : Recording
        The samples.
    array : Array
        As its file states it.
    gap : Gap
        Diagnosis.
    calibration : Calibration
        With the effects of the diagnosis.
    found : Search
        The search that the diagnosis rests on: models without and with the causes.
    """

    recording: Recording = field(repr=False)
    array: Array
    gap: Gap
    calibration: Calibration
    found: Search = field(repr=False)


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
        of_recording, of_simulation = self.recording.gap.signature, self.simulation.gap.signature
        return {
            "recording": _without_counterpart(of_recording, of_simulation),
            "simulation": _without_counterpart(of_simulation, of_recording),
        }


def _without_counterpart(laws: tuple[Signature, ...], others: tuple[Signature, ...]) -> tuple[Signature, ...]:
    return tuple(
        law
        for law in laws
        if not any(law.law == one.law and not set(law.sensors).isdisjoint(one.sensors) for one in others)
    )
