"""A calibration that is kept up to date while samples arrive, and what is done when a sensor has changed.

Samples are gathered to blocks. Each is weighed and then learned; where the sensors have changed, what was learned since
is given up, and what is configured is done: the calibration of before stays (``tell``), the errors that have changed
are taken for unknown and learned anew (``learn``), or the stored calibration comes back (``restore``). The gradient of
a field that a source makes is no change of a sensor: while it lasts nothing is learned.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import ridged, scaled
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import ALL_BIASES, SEVERAL
from tam_calibration.fit.identifiability import open_parameters
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.prior import Prior
from tam_calibration.live.change import GRADIENT
from tam_calibration.live.change_window import BLOCK_S, BlockMeans, BlockNoise, ChangeWindow, Step, Suspicion
from tam_calibration.live.recursion import (
    Belief,
    MomentLikelihood,
    Recursion,
    SampleMoments,
    Stretch,
    Trial,
    Walk,
    solve,
)
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray

ON_CHANGE = ("tell", "learn", "restore")
"""What is done when a sensor has changed."""

WIDENED = 3.0
"""Standard deviation of a change over what is seen of it, so that the samples alone tell its size."""

PUBLISHED_FROM = 0.5
"""Part of the published standard errors, in root mean square over all directions, by which errors or standard errors
change before they are published: less is small compared with the uncertainty."""


MOST_CHANGES = 100
"""Changes that are kept, so that memory is bounded."""


@dataclass(frozen=True)
class Change:
    """A change that was decided on.

    Parameters
    ----------
    since_s : float
        Stamp of the block in which it came, seconds.
    sentence : str
        What has changed, by how much, and what was done.
    sensor : int
        Number of the sensor from 1; 0 where it is not one alone.
    parameters : tuple of str
        Kinds of errors, the most probable first, of which the samples cannot tell which has changed.
    """

    since_s: float
    sentence: str
    sensor: int
    parameters: tuple[str, ...]

    @property
    def law(self) -> str:
        """What it does to readings, as a diagnosis says it: a step of an offset, a gain, or both."""
        return _law_of(self.parameters)

    @property
    def is_of_field(self) -> bool:
        """Whether the field has most probably changed, and no sensor."""
        return self.parameters[0] == GRADIENT


@dataclass(frozen=True, eq=False)
class LiveState:
    """All that a process needs to go on where another ended.

    Parameters
    ----------
    recursion : Recursion
        What is known.
    published : Belief
        What was published last.
    paused_by : str
        What keeps it from learning: "sensors", "field", or "" for nothing.
    learned : int
        Number of samples that were learned.
    energy, freedom : float
        Squared residuals of all blocks in units of the stated noise, and their degrees of freedom.
    changes : tuple of Change
        In the order of time.
    """

    recursion: Recursion
    published: Belief
    paused_by: str = ""
    learned: int = 0
    energy: float = 0.0
    freedom: float = 0.0
    changes: tuple[Change, ...] = ()

    @property
    def excess(self) -> float:
        """Variance of the residuals over that which the noise is stated to have; at least 1."""
        return max(1.0, self.energy / self.freedom) if self.freedom else 1.0


class Live:
    """Learns from samples as they arrive.

    Parameters
    ----------
    prior : Prior
        The stored calibration, widened by the time since.
    on_change : str
        One of `ON_CHANGE`.
    state : LiveState, optional
        Of a process that ended; by default it begins with the prior.

    Raises
    ------
    InputError
        When the scale of the calibration is arbitrary, or it leaves errors open: over errors so uncertain lengths are
        no straight lines, which the recursion takes them for.
    """

    def __init__(self, prior: Prior, on_change: str, state: LiveState | None = None) -> None:
        if not prior.knows_scale:
            raise InputError(
                "the calibration was made without a scalar magnetometer, its scale is arbitrary and cannot be kept up "
                "to date: calibrate with one"
            )
        stored = prior.calibration
        if names := open_parameters(stored.standard_errors.ravel(), stored.intensity_T):
            raise InputError(
                f"the calibration does not determine {names}, and cannot be kept up to date: calibrate further turns "
                "first, with it for a prior"
            )
        self.on_change, self._calibration = on_change, stored
        # What lasted ashore lasts at sea: samples contain as little information as they did there.
        self._likelihood = MomentLikelihood(prior.errors, stored.array, stored.intensity_T, stored.variance_factors)
        self._noise = BlockNoise(stored.array)
        self._walk = Walk(prior)
        self._stored = Belief(prior.errors, prior.covariance, np.nan, np.nan)
        self._window = ChangeWindow(prior, self._walk)
        self._stretch = Stretch(prior)
        self._suspicion: Suspicion | None = None
        self._rows: list[FloatArray] = []
        self._problem = ""
        self._left_out = 0
        self._trial: Trial | None = None
        self._is_restored = False
        self.state = state or LiveState(Recursion.at(self._stored), self._stored)

    def add(self, rows: FloatArray, rates: FloatArray | None = None) -> None:
        """Take samples.

        Parameters
        ----------
        rows : (n, 3K + 3) array
            Stamp, seconds; readings, tesla; intensity, tesla, and temperature, °C, each NaN where there is none.
        rates : (n, 3) array, optional
            Angular velocity, rad/s; NaN where there is none.
        """
        rates = np.full((len(rows), 3), np.nan) if rates is None else rates
        for row in np.column_stack([rows, rates]):
            if self._rows and not 0 <= row[0] - self._rows[0][0] < BLOCK_S:
                block, self._rows = np.array(self._rows), []
                self._take(block)
            self._rows.append(row)

    def news(self) -> Calibration | None:
        """Return the calibration once it has changed by `PUBLISHED_FROM` since this returned one; else None.

        It is tried before, on samples that it was not learned from: one that predicts them worse is not published.
        One that is restored is published at once.
        """
        if self._trial is not None and self._trial.has_passed and not self.is_suspicious:
            self.state, self._trial = replace(self.state, published=self._trial.belief), None
        elif not self._is_restored:
            return None
        self._is_restored = False
        return self.calibration

    @property
    def calibration(self) -> Calibration:
        """As it was published last; its residuals are those of the recording of the stored calibration."""
        published, stored, learned = self.state.published, self._calibration, self.state.learned
        if not learned:
            return stored
        remark = f"updated with {learned} samples since its recording, whose residuals these are"
        return replace(
            stored,
            errors=published.errors,
            covariance=published.covariance,
            samples=stored.samples + learned,
            time_span_s=(stored.time_span_s[0], max(stored.time_span_s[1], published.time_s)),
            warnings=(*stored.warnings, remark),
        )

    @property
    def is_suspicious(self) -> bool:
        """Whether a change is looked into."""
        return self._suspicion is not None

    @property
    def sentence(self) -> str:
        """What it does, for people."""
        if not self._left_out:
            return self._state_in_words
        field = self._calibration.array.field
        return f"{self._state_in_words}; {self._left_out} samples with no field of {field.range_uT} µT are left out"

    @property
    def _state_in_words(self) -> str:
        if self._problem:
            return self._problem
        learned = f"updated with {self.state.learned} samples"
        if self.state.paused_by:
            return f"not updated any more, {learned} before"
        if self._suspicion is not None:
            names = " or ".join(each.hypothesis.name for each in self._suspicion.found) or "it may have passed"
            return f"{learned}; a change is looked into: {names}"
        return learned

    def _take(self, rows: FloatArray) -> None:
        """Weigh a block, learn it, and decide."""
        rows = self._in_a_field(rows)
        if not len(rows):
            return
        rows, rates = rows[:, :-3], rows[:, -3:]
        begin_s, end_s = float(rows[0, 0]), float(rows[-1, 0])
        known = rows[np.isfinite(rows[:, -1]), -1]
        temperature_C = float(known.mean()) if known.size else np.nan
        readings = rows[:, 1:-2].reshape(len(rows), -1, 3)
        recursion = self.state.recursion.dated(begin_s, temperature_C)
        means = BlockMeans.of(recursion.now.errors, readings, rows[:, -2])
        self._follow_noise(means, recursion.now)
        moments = self._likelihood.moments(readings, rows[:, -2])
        here = self._likelihood.linearize(moments, recursion.now.errors)
        step = Step(recursion.now, self.state.excess, self._likelihood, means, here, moments, begin_s)
        self._suspicion = self._window.add(step, end_s, temperature_C)
        self._try(moments)
        energy, freedom = _own_energy(here, moments)
        self.state = replace(
            self.state, recursion=recursion, energy=self.state.energy + energy, freedom=self.state.freedom + freedom
        )
        if not self.state.paused_by:
            self._learn(moments, end_s, temperature_C)
            self._learn_turns(rows, rates, recursion.now)
        if self._suspicion is not None and self._suspicion.is_decided:
            self._decide(self._suspicion, end_s, temperature_C)
        elif self._suspicion is None and self.state.paused_by and self._window.is_full:
            self._go_on(end_s, temperature_C)

    def _try(self, moments: SampleMoments) -> None:
        """Try what is known on the samples of a block; begin anew where that has failed, or a change is looked into."""
        now, published = self.state.recursion.now, self.state.published
        if self.is_suspicious or (self._trial is not None and self._trial.is_over and not self._trial.has_passed):
            self._trial = None
        is_begun = self._noise.is_known and self._trial is None and not self.is_suspicious
        if is_begun and published.change_to(now) >= PUBLISHED_FROM:
            self._trial = Trial(now)
        if self._trial is not None:
            self._trial = self._trial.after(moments, published, self._likelihood)

    def _follow_noise(self, means: BlockMeans, now: Belief) -> None:
        """Weigh samples by what the noise of blocks shows, or that of the stored calibration showed."""
        self._noise.add(means)
        errors = now.errors if self._suspicion is None else self._suspicion.first.before.errors
        factors = self._calibration.variance_factors.at_least(self._noise.factors(errors))
        # Part by which the variance of the noise changes before samples are weighed anew.
        if not np.allclose(factors, self._likelihood.factors, rtol=0.1, atol=0):
            self._likelihood = replace(self._likelihood, factors=factors)

    def _in_a_field(self, rows: FloatArray) -> FloatArray:
        """Return the samples in which most sensors read a field that the array may be in, and NaN for no such scalar.

        A driver that sends zeros or another unit tells nothing, and would end the update.
        """
        bounds, rows = self._calibration.array.field, rows.copy()
        fields_T = self.state.recursion.now.errors.restore(rows[:, 1:-5].reshape(len(rows), -1, 3))
        rows[~bounds.hold_each(rows[:, -5]), -5] = np.nan
        is_told = bounds.hold_each(np.median(norm(fields_T, axis=2), axis=1))
        self._left_out += int(np.count_nonzero(~is_told))
        return np.asarray(rows[is_told])

    def _learn(self, moments: SampleMoments, end_s: float, temperature_C: float) -> None:
        try:
            recursion = self.state.recursion.after(moments, end_s, temperature_C, self._likelihood, self._walk)
        except Refused as problem:
            self._problem = str(problem)
            return
        self._problem = ""
        self.state = replace(self.state, recursion=recursion, learned=self.state.learned + moments.count)

    def _learn_turns(self, rows: FloatArray, rates: FloatArray, before: Belief) -> None:
        """Learn what the gyroscope tells of a stretch in which no change is looked into."""
        if self.is_suspicious:
            self._stretch.clear()
            return
        self._stretch.add(rows, rates, before)
        if not self._stretch.is_full:
            return
        if (learned := self._stretch.information(self._likelihood.factors)) is None:
            return
        try:
            self.state = replace(self.state, recursion=self.state.recursion.joined_with(*learned, self._likelihood))
        except Refused as problem:
            self._problem = str(problem)

    def _decide(self, suspicion: Suspicion, end_s: float, temperature_C: float) -> None:
        """Do what is configured; a change that was reported already, or has passed, is not reported."""
        paused_by = self.state.paused_by
        self._window.clear()
        self._suspicion = None
        if not suspicion.found:
            if not paused_by:
                self.state = replace(self.state, recursion=self._anew(suspicion, end_s, temperature_C))
            return
        of_field = suspicion.found[0].hypothesis.parameters == GRADIENT
        if paused_by == "sensors" or (paused_by and of_field):
            return
        recursion, paused_by, done = Recursion.at(suspicion.first.before), "sensors", "it is not learned"
        if of_field:
            paused_by, done = "field", "nothing is learned while it lasts"
        elif self.on_change == "learn":
            recursion, paused_by, done = self._anew(suspicion, end_s, temperature_C), "", "it is learned anew"
        elif self.on_change == "restore":
            recursion, done = Recursion.at(self._stored).dated(end_s, temperature_C), "the stored calibration is back"
            self.state = replace(self.state, published=recursion.now)
            self._trial, self._is_restored = None, True
        change = _change(suspicion, done)
        changes = (*self.state.changes, change)[-MOST_CHANGES:]
        self.state = replace(self.state, recursion=recursion, paused_by=paused_by, changes=changes)

    def _anew(self, suspicion: Suspicion, end_s: float, temperature_C: float) -> Recursion:
        """Return the recursion from before a change on, in which what has changed is unknown, without the change."""
        before, after = suspicion.first.before, suspicion.after
        covariance = before.covariance + self._walk.covariance(before, end_s, temperature_C)
        for evidence in suspicion.found:
            directions = self._walk.kept(evidence.hypothesis.directions) * (WIDENED * evidence.reach)
            covariance = covariance + directions @ directions.T
        begin = replace(before, covariance=covariance, time_s=end_s)
        moments = sum((step.moments for step in after), SampleMoments.none(before.errors.sensor_count))
        try:
            now = solve(begin, moments, end_s, before.temperature_C, self._likelihood, before.errors)
        except Refused as problem:
            self._problem = str(problem)
            return Recursion.at(begin)
        return Recursion(begin, moments, now)

    def _go_on(self, end_s: float, temperature_C: float) -> None:
        """Learn again: half a minute has shown nothing of the change."""
        now = self.state.recursion.now
        covariance = now.covariance + self._walk.covariance(now, end_s, temperature_C)
        recursion = Recursion.at(replace(now, covariance=covariance, time_s=end_s))
        self.state = replace(self.state, recursion=recursion, paused_by="")
        self._window.clear()


def _change(suspicion: Suspicion, done: str) -> Change:
    first, *others = (evidence.hypothesis for evidence in suspicion.found)
    sentence = suspicion.found[0].sentence
    if others:
        names = " or ".join(each.name for each in others)
        sentence = f"{sentence}; or, which the motion cannot tell apart: {names}"
    sensors = {each.sensor for each in (first, *others)}
    sensor = first.sensor if len(sensors) == 1 else 0
    kinds = tuple(dict.fromkeys(each.parameters for each in (first, *others)))
    return Change(suspicion.since_s, f"{_law_of(kinds)}, in a step: {sentence}; {done}", sensor, kinds)


def _law_of(kinds: tuple[str, ...]) -> str:
    """Return what a change of one of some kinds of errors does to readings."""
    laws = {SEVERAL: "offset and gain", "bias": "offset", ALL_BIASES: "offset", GRADIENT: "offset"}
    return " or ".join(dict.fromkeys(laws.get(kind, "gain") for kind in kinds))


def _own_energy(here: Linearization, moments: SampleMoments) -> tuple[float, float]:
    """Return the squared residuals that a block leaves when it is fitted by itself, and their degrees of freedom."""
    both, count = here.both, len(here.correction) // 12
    freedom = moments.count * (3 * count - 3) + moments.scalar_count - (12 * count - 3)
    if freedom <= 0:
        return 0.0, 0.0
    unit, scale = scaled(both.information)
    fall = both.score / scale @ np.linalg.solve(ridged(unit), both.score / scale)
    return max(both.energy - float(fall), 0.0), float(freedom)
