"""What a physical effect is: the channels that it needs, what it adds to the readings, what it leaves in a residual.

A sample's rows are the readings of all sensors, row 3 i + a for axis a of sensor i, and last the scalar magnetometer.
All that the author of an effect needs can be imported from here.
"""

import tomllib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates, jumps
from tam_calibration.effects.grades import LEAST_SAMPLES
from tam_calibration.effects.recursions import Memory
from tam_calibration.effects.residuals import Finding, WhitenedResiduals
from tam_calibration.effects.term import Coefficient, Key, Term, rows_of
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect, Shape
from tam_calibration.model.units import FloatArray

__all__ = [
    "ALL",
    "SCALAR",
    "Coefficient",
    "Contribution",
    "Covariates",
    "Effect",
    "Finding",
    "FittedEffect",
    "FoundEffect",
    "Limit",
    "LinearEffect",
    "Shape",
    "Sized",
    "StreamKind",
    "Term",
    "WhitenedResiduals",
]


@dataclass(frozen=True)
class Limit:
    """The largest size, in SI units, that a value of an effect has in nature, and the source that says so."""

    largest: float
    source: str
    unit: str = "1"


@dataclass(frozen=True)
class Sized:
    """A value of a fitted effect by its name, the largest over its places, beside the largest in nature."""

    name: str
    value: float
    limit: Limit

    @property
    def is_natural(self) -> bool:
        """Whether it is no larger than the largest in nature, whatever its sign."""
        return abs(self.value) <= self.limit.largest


def _told(value: Any) -> Any:
    """Return a value of ``causes.toml``: texts on one line, lists as tuples, largest sizes as limits."""
    if isinstance(value, str):
        return " ".join(value.split())
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, dict):
        return value
    told = {key: _told(each) for key, each in value.items()}
    return Limit(**told) if "largest" in told else told


def read_causes(module: str) -> dict[str, dict[str, Any]]:
    """Return what the ``causes.toml`` beside a module tells of each cause, by its name."""
    told: dict[str, dict[str, Any]] = _told(tomllib.loads(Path(module).with_name("causes.toml").read_text("utf-8")))
    return told


CAUSES: dict[str, dict[str, Any]] = {
    known.pop("class"): {"name": name, **known} for name, known in read_causes(__file__).items()
}
"""What is known of the causes of this package, by module and class of their effects."""


class Effect(ABC):
    """A physical effect that the model of scale factor, non-orthogonality, bias and misalignment does not hold.

    Attributes
    ----------
    name : str
        As in reports and on the command line.
    title : str
        For people: "bias that drifts with temperature".
    physics : str
        One or two sentences: what happens, and the source.
    channels : tuple of str
        Names of the channels of ``Recording`` that it needs, further ones such as ``actuator_rudder`` among them.
    excitation : str
        What a recording must do to make it visible.
    told_of_samples : str
        What it takes ``LEAST_SAMPLES`` to tell: "a jump"; empty where its own ``obstacle`` says when samples are few.
    told_by_others : str
        What one sensor alone does not tell: "where the field was"; empty where one is enough.
    needs_motion : bool
        Whether only a continuous motion shows it.
    limits : mapping
        The largest sizes of its values, by the name of a value, or of a term for all values of it.
    may_repeat : bool
        Whether it may happen more than once, each time in another form.
    is_of_lone_samples : bool
        Whether it strikes samples here and there, of which there must be few, however often it happens.
    shows_as : tuple of str
        Names of the faults of channels that it makes, as the check before a fit has them (``integrity``).
    output_stage : int
        When it acts on the rows of a simulation: an effect of a higher stage comes after all of lower ones.
    units : dict
        SI unit of each value of an effect that has no terms to tell it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    physics: ClassVar[str]
    channels: ClassVar[tuple[str, ...]] = ()
    excitation: ClassVar[str]
    told_of_samples: ClassVar[str] = ""
    told_by_others: ClassVar[str] = ""
    needs_motion: ClassVar[bool] = False
    limits: ClassVar[Mapping[str, Limit]] = {}
    may_repeat: ClassVar[bool] = False
    is_of_lone_samples: ClassVar[bool] = False
    shows_as: ClassVar[tuple[str, ...]] = ()
    output_stage: ClassVar[int] = 0
    units: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls) -> None:
        """Take over what ``causes.toml`` tells of an effect of this package; others state it themselves."""
        super().__init_subclass__()
        place = f"{cls.__module__}:{cls.__name__}".removeprefix(f"{__package__}.")
        for key, value in CAUSES.get(place, {}).items():
            setattr(cls, key, value)

    def is_natural(self, covariates: Covariates, fitted: FittedEffect) -> bool:
        """Whether no value of a fitted effect is larger than any in nature.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Its values are compared with ``limits``.
        """
        return all(sized.is_natural for sized in self.sizes(covariates, fitted))

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return the sizes of a fitted effect of which nature has a largest one.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Its values are compared with ``limits``.
        """
        largest: dict[str, Sized] = {}
        for one in fitted.contributions:
            for name, value in one.values.items():
                limit = self.limits.get(name, self.limits.get(one.term))
                if limit is not None and (name not in largest or abs(value) > abs(largest[name].value)):
                    largest[name] = Sized(name, value, limit)
        return list(largest.values())

    def needs(self, fitted: FittedEffect) -> tuple[str, ...]:
        """Return the names of the channels that tell what a fitted effect adds; by default those of the class.

        Parameters
        ----------
        fitted : FittedEffect
            With its numbers.
        """
        return self.channels

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return why a recording that has the channels cannot show this effect, in one clause; None where it can."""
        if self.told_of_samples and covariates.sample_count < LEAST_SAMPLES:
            return f"{covariates.sample_count} samples are too few to tell {self.told_of_samples}"
        if self.told_by_others and covariates.sensor_count == 1:
            return f"one sensor alone does not tell {self.told_by_others}"
        return jumps(covariates) if self.needs_motion else None

    @abstractmethod
    def add(self, rows_T: FloatArray, covariates: Covariates, fitted: FittedEffect, generator: Generator) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla.

        Parameters
        ----------
        rows_T : (N, 3K + 1) array
            Readings of K sensors, and the scalar reading, without the effect, tesla.
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Where the effect acts, and its numbers.
        generator : numpy.random.Generator
            Source of the random numbers.
        """


class LinearEffect(Effect):
    """An effect that adds a linear combination of known functions to the rows, for given parameters of its shape.

    Attributes
    ----------
    is_free_in_time : bool
        Whether it is a free function of time, so that whole blocks of time cannot be predicted from the others.
    has_memory : bool
        Whether what it adds to a sample depends on the way to it, so that it differs between visits to a pose.
    is_causal : bool
        Whether what it adds to a sample depends on no later one, so that it can be taken off while samples arrive; its
        recursions then use the memory of the covariates.
    is_of_site : bool
        Whether it belongs to where the recording was made: it does not go with the array to another place.
    is_of_one_sensor : bool
        Whether it is a fault of a single sensor: two that have it have two, each with a shape of its own.
    is_step : bool
        Whether it changes at the times of its shape, and is constant between them.
    has_exact_shapes : bool
        Whether the shapes that it returns are the best ones, and not points of a grid between which to look further.
    limit_of : tuple of str
        Names of the effects that become this one for some of their numbers: data can show that they are more than it,
        never that they are not.
    nearly_within : tuple of str
        Names of further effects that explain nearly all that it does: beside one of either, in the same sensor, it
        says nothing new.
    not_sought : tuple of str
        Names of terms that a fit may have and the diagnosis does not choose: with them it would be any cause of a law.
    shape_units : dict
        SI unit of each parameter of the shape.
    largest_signal : Limit, optional
        Of what it adds to any row, root of the mean square over the samples: in tesla, or as part of the field's.
    """

    is_free_in_time: ClassVar[bool] = False
    has_memory: ClassVar[bool] = False
    is_causal: ClassVar[bool] = True
    is_of_site: ClassVar[bool] = False
    is_of_one_sensor: ClassVar[bool] = False
    is_step: ClassVar[bool] = False
    has_exact_shapes: ClassVar[bool] = False
    limit_of: ClassVar[tuple[str, ...]] = ()
    nearly_within: ClassVar[tuple[str, ...]] = ()
    not_sought: ClassVar[tuple[str, ...]] = ()
    shape_units: ClassVar[Mapping[str, str]] = {}
    largest_signal: ClassVar[Limit | None] = None

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return the sizes of a fitted effect, values and the whole, of which nature has a largest one.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Its values are compared with ``limits``, its signal with ``largest_signal``.
        """
        sizes = super().sizes(covariates, fitted)
        if self.largest_signal is None:
            return sizes
        size = float(np.sqrt(np.mean(self.signal(covariates, fitted) ** 2, axis=0)).max())
        if self.largest_signal.unit == "1":
            intensity_T = float(np.sqrt(np.mean(covariates.intensity_T**2)))
            return [*sizes, Sized("part of the field", size / intensity_T, self.largest_signal)]
        return [*sizes, Sized("size", size, self.largest_signal)]

    def is_within(self, other: str) -> bool:
        """Whether the effect of another name explains all, or nearly all, that this one does."""
        return other in self.limit_of or other in self.nearly_within

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the shapes to try; by default the one without parameters.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            In which the effect is searched.
        """
        return ({},)

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> Sequence[Shape]:
        """Return the shapes of an effect that comes and goes at some times, at which a law does; by default none.

        Parameters
        ----------
        times_s : sequence of float
            At which it begins, ends, begins again and so on, seconds.
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        """
        return ()

    def is_same(self, shape: Shape, other: Shape, covariates: Covariates) -> bool:
        """Whether a recording does not tell two shapes apart, so that they are one cause; by default it does.

        Parameters
        ----------
        shape, other : Shape
            Parameters of two shapes by name, SI units.
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        """
        return False

    @abstractmethod
    def terms(self, covariates: Covariates, shape: Shape) -> Iterable[Term]:
        """Return all that the effect could add, at all sensors that it could act on; once, and in the same order.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            Parameters of the shape by name, SI units, as ``shapes`` returns them.
        """

    def signal(self, covariates: Covariates, fitted: FittedEffect) -> FloatArray:
        """Return what the effect adds to the rows, (N, 3K + 1), tesla.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Shape and coefficients of the effect.

        Raises
        ------
        InputError
            When the shape lacks a parameter, or there is no such term or coefficient.
        """
        row_count = covariates.scalar_row + 1
        total = np.zeros((covariates.sample_count, row_count))
        try:
            terms = {term.key: term for term in self.terms(covariates, fitted.shape)}
        except KeyError as missing:
            raise InputError(f"the effect {self.name} needs the value {missing}") from None
        for contribution in fitted.contributions:
            term = _term_of(contribution, terms, self.name)
            values = np.array([contribution.values.get(coefficient.name, 0.0) for coefficient in term.coefficients])
            total += term.signal(values, row_count)
        return total

    def add(self, rows_T: FloatArray, covariates: Covariates, fitted: FittedEffect, generator: Generator) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla.

        Parameters
        ----------
        rows_T : (N, 3K + 1) array
            Readings of K sensors, and the scalar reading, without the effect, tesla.
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Where the effect acts, and its numbers.
        generator : numpy.random.Generator
            Not used: the effect is not random.
        """
        return rows_T + self.signal(covariates, fitted)


def _term_of(contribution: Contribution, terms: Mapping[Key, Term], effect: str) -> Term:
    """Return the term of a contribution, which must exist and have the coefficients that are named."""
    place = contribution.sensor, contribution.axis
    term = terms.get((*place, contribution.term))
    if term is None:
        known = [name for sensor, axis, name in terms if (sensor, axis) == place]
        stated = f"they are {', '.join(known)}" if known else "there are none of that sensor and axis"
        raise InputError(f"{quoted(contribution.term)} is none of the terms of {effect}: {stated}")
    names = [coefficient.name for coefficient in term.coefficients]
    unknown = contribution.values.keys() - set(names)
    if unknown:
        raise InputError(
            f"{min(unknown)!r} is no value of the term {contribution.term!r} of {effect}: it has {', '.join(names)}"
        )
    return term


StreamKind = Literal["of_sample", "of_course", "of_whole"]
"""How an effect is added to samples as they arrive.

``of_sample``: one by one, with what the covariates remember of earlier ones. ``of_course``: from the course of the
field up to then. ``of_whole``: only to whole recordings.
"""


class FoundEffect(Effect):
    """An effect that is found in the readings or the residual by another test than regression.

    Attributes
    ----------
    stream : str
        How it is added to samples as they arrive, see ``StreamKind``.
    is_certain : bool
        Whether the readings prove it beyond chance, so that it precedes effects that explain as much.
    """

    stream: ClassVar[StreamKind] = "of_whole"
    is_certain: ClassVar[bool] = False

    @abstractmethod
    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return what was found, or why nothing was, in one clause."""

    def of_samples(
        self,
        parts: Iterable[Contribution],
        residuals: WhitenedResiduals,
        flagged: NDArray[np.bool_],
        saved: float,
        parameter_count: int,
        nats: float = 0.0,
    ) -> Finding:
        """Return the finding of an effect that explains a part of the energy of the counted and flagged samples.

        Parameters
        ----------
        parts : iterable of Contribution
            Where it was found, with its numbers.
        residuals : WhitenedResiduals
            Of N samples.
        flagged : (N,) array of bool
            Samples that it strikes.
        saved : float
            Energy that it explains.
        parameter_count : int
            Number of its parameters.
        nats : float
            Code length of what it needs besides, which counts as further parameters.
        """
        used = residuals.is_counted | flagged
        before, count = float(residuals.energy[used].sum()), float(residuals.channel_count[used].sum())
        gain = count * float(np.log(before / max(before - saved, np.finfo(float).eps * before)))
        return self.found(parts, gain, parameter_count + int(np.ceil(2 * nats / np.log(count))), flagged=flagged)

    def found(
        self, parts: Iterable[Contribution], gain: float, parameter_count: int, **arrays: NDArray[Any]
    ) -> Finding:
        """Return a finding of this effect.

        Parameters
        ----------
        parts : iterable of Contribution
            Where it was found, with its numbers.
        gain : float
            See ``Finding``, as the rest.
        parameter_count : int
            Number of its parameters.
        **arrays : array
            ``flagged``, ``variance`` or ``spread_T``.
        """
        fitted = FittedEffect(self.name, {}, tuple(parts))
        return Finding(fitted, gain, parameter_count, is_certain=self.is_certain, **arrays)

    def add(self, rows_T: FloatArray, covariates: Covariates, fitted: FittedEffect, generator: Generator) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla.

        Parameters
        ----------
        rows_T : (N, 3K + 1) array
            Readings of K sensors, and the scalar reading, without the effect, tesla.
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Where the effect acts, and its numbers.
        generator : numpy.random.Generator
            Source of the random numbers, of each contribution another one, so that batches change no number.
        """
        rows, memory = rows_T.copy(), covariates.memory or Memory()
        sources = memory.recall(generator.spawn(len(fitted.contributions)))
        memory.keep(sources)
        for part, source in zip(fitted.contributions, sources, strict=True):
            touched = rows_of(part, covariates)
            rows[:, touched] = self.put(rows[:, touched], part, covariates, source)
        return rows

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings of the rows that a contribution acts on with the effect in them.

        Parameters
        ----------
        rows_T : (N, n) array
            Readings of these rows, tesla: a copy, which may be changed.
        part : Contribution
            Of the effect.
        run : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        source : numpy.random.Generator
            Source of the random numbers.
        """
        raise NotImplementedError
