"""The signature of a gap: its laws with their places, courses and shares, as the answer states them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.converter import find_lattices
from tam_calibration.effects.grades import FEWEST, MOST, NEGLIGIBLE, NOTABLE, SLIGHT
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.effects.states import Times
from tam_calibration.gap.floor import repeated
from tam_calibration.gap.laws.decisions import LEAST_EVIDENCE, LEAST_SHARE, TIE
from tam_calibration.gap.laws.find import Found, curve_of, predictive_laws
from tam_calibration.gap.laws.law import FREE, SCALAR, Place, Signature
from tam_calibration.gap.laws.patterns import AXES
from tam_calibration.gap.laws.places import places_of, within
from tam_calibration.gap.laws.scatter import law_of, noise_follows, scatter_of, spikes
from tam_calibration.gap.laws.sensors import as_good_elsewhere
from tam_calibration.gap.laws.states import change_times
from tam_calibration.gap.laws.whitened import Residual, residual_of
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import outlying_samples


@dataclass(frozen=True, eq=False)
class Law:
    """A law of a gap with the fits that it rests on.

    Parameters
    ----------
    signature : Signature
        As the answer states it.
    part : float
        Part that it has of the residual's energy, with that of the noise.
    found : tuple of Found
        Of a law in several sensors more than one; none of a law that predicts no sample from others.
    whole : Residual, optional
        In which it was found, with the samples that lie far off.
    """

    signature: Signature
    part: float
    found: tuple[Found, ...] = ()
    whole: Residual | None = None

    def times(self, residual: Residual | None = None) -> Times:
        """Return the times at which it may come and go, seconds: of each course of an offset or gain that jumps.

        Parameters
        ----------
        residual : Residual, optional
            Of a model with more causes; by default that in which the law was found.
        """
        whole = residual or self.whole
        if whole is None or self.signature.law not in ("offset", "gain"):
            return ()
        return tuple(
            times
            for one in self.found
            for times in change_times(one.alike(whole), one.best.pattern, whole.scaled(one.residual.noise**-0.5))
        )

    def is_gone_from(self, residual: Residual, others: Sequence["Law"], part: float = LEAST_SHARE) -> bool:
        """Say whether the residual of a model with one more cause has too little of the law for a law of its own.

        Of a law that follows a channel or a tone, which few causes do, it may have more.

        Parameters
        ----------
        residual : Residual
            Of the model with the cause.
        others : sequence of Law
            Laws beside this one, which are taken off before.
        part : float
            Part that may be left of a law.
        """
        for one in (found for law in others for found in law.found):
            residual = residual.without(one.signal(residual, one.alike(residual)))
        left = sum(one.left_in(residual) for one in self.found)
        part = NOTABLE if self.signature.course in ("channel", "tone") else part
        return left < max(part * sum(one.predicted for one in self.found), LEAST_EVIDENCE)


def laws_of(residual: Residual, gap: float, most: int = 3) -> tuple[Law, ...]:
    """Return the laws of what a model leaves, the strongest first; none where no law is certain.

    Parameters
    ----------
    residual : Residual
        Of the nominal fit, or of a model with causes.
    gap : float
        Energy of the whole gap, of which each law has its share.
    most : int
        As of ``predictive_laws``.
    """
    whole, total = max(residual.excess, 1.0), float((residual.z**2).sum())
    laws, found = _signatures(residual, whole, most)
    each = [
        Law(law, law.energy * whole / total, tuple(found[index : index + 1]), residual)
        for index, law in enumerate(laws)
    ]
    kept = [
        one
        for one in each
        if one.signature.energy >= LEAST_SHARE or (one.signature.law == "samples" and one.signature.evidence > 0)
    ]
    share = min(whole / max(gap, 1.0), 1.0)
    ranked = sorted(_merged(kept), key=lambda one: -one.signature.energy)
    signatures = _with_field([one.signature for one in ranked], residual.sensor_count)
    return tuple(
        replace(law, signature=replace(one, energy=share * one.energy))
        for law, one in zip(ranked, signatures, strict=True)
    )


def _with_field(laws: list[Signature], sensor_count: int) -> list[Signature]:
    """Return laws with all sensors as a place of those that change freely in three sensors or more.

    A field that changes and is not uniform looks like a law of its own in each sensor, if the attitude is unknown.
    """
    changing = {one.sensors for one in laws if one.course in FREE and one.law in ("offset", "gain")}
    if len([place for place in changing if place != SCALAR and len(place) == 1]) < 3:
        return laws
    every: Place = tuple(range(1, sensor_count + 1))
    return [replace(one, places=(*one.places, every)) if one.sensors in changing else one for one in laws]


def times_of(model: Model) -> Times:
    """Return the times at which the laws of what a model leaves may come and go, seconds.

    Parameters
    ----------
    model : Model
        The nominal fit, or one with causes.
    """
    residual = residual_of(model)
    return tuple(times for law in laws_of(residual, residual.excess) for times in law.times())


def _signatures(residual: Residual, whole: float, most: int) -> tuple[list[Signature], list[Found]]:
    """Return all laws, first those that predict, and the fits of these."""
    if lattice := _lattice(residual):
        return [lattice], []
    recording = residual.model.recording
    held = repeated(recording.readings_T)[residual.index]
    # A sensor at half the rate repeats half of its readings, and has lost none.
    lost = np.flatnonzero((held.sum(axis=0) >= FEWEST) & (held.mean(axis=0) < MOST - SLIGHT)).tolist()
    outlying = spikes(residual) | outlying_samples(recording)[residual.index]
    apart = outlying | held[:, lost].any(axis=1)
    quiet = residual.taking(~apart)
    found, rest = predictive_laws(quiet, whole, most)
    if apart.any():
        rest = _at_all(residual, quiet, found)
        is_large = (rest.z**2).sum() - rest.size > whole / 2
        # A clipped axis is far off in few samples too, but these are a function of its reading.
        if is_large and not lost and _are_at_like_readings(residual, outlying):
            again, left = predictive_laws(residual, whole, most)
            if again and again[0].best.pattern.law == "own_field":
                found, rest, outlying = again, left, np.zeros_like(outlying)
    laws = [_of_found(one, residual, whole) for one in found]
    laws += [_of_samples(rest, whole, held[:, sensor], (sensor + 1,)) for sensor in lost]
    spiky = [_of_samples(rest, whole, outlying, None)] if outlying.any() else []
    laws += spiky
    if not lost:
        scattered = scatter_of(rest, whole)
        least = max([LEAST_SHARE, *(one.energy for one in spiky)])
        # The largest values of noise in one channel look like spikes, which explain only a part of it.
        if scattered and scattered[0].energy > least and not (spiky and scattered[0].law == "samples"):
            laws = [*(one for one in laws if one not in spiky), _of_noise(scattered, rest)]
    return laws or _common_noise(residual), found


def _are_at_like_readings(residual: Residual, chosen: NDArray[np.bool_]) -> bool:
    """Say whether many of some samples (N,) are next to each other in the order of the readings of an axis."""
    in_order = chosen[residual.own.argsort(axis=0)]
    return bool(((in_order[1:] & in_order[:-1]).sum(axis=0) > NOTABLE * chosen.sum()).any())


def _common_noise(residual: Residual) -> list[Signature]:
    """Return the law of noise that all sensors have more than stated, beyond what data sheets are off."""
    base = residual.model.base()
    count = max(base.channels.count - base.rank, 1.0)
    beyond = base.energy / count / LARGEST_NOISE**2
    if beyond <= 1:
        return []
    sensors: Place = tuple(range(1, residual.sensor_count + 1))
    evidence = count * (beyond - 1 - np.log(beyond)) / 2
    return [Signature("noise", "random", sensors, tuple(AXES), 1.0, (sensors,), None, (), float(evidence))]


def _at_all(residual: Residual, quiet: Residual, found: list[Found]) -> Residual:
    """Return the residual of all samples without laws and nominal parameters, fitted to the quiet samples alone."""
    z = residual.z - sum(one.signal(residual, one.residual) for one in found)
    return replace(residual, z=z - quiet.seen.explained(z, residual.seen))


def _of_samples(rest: Residual, whole: float, chosen: NDArray[np.bool_], sensors: Place | None) -> Signature:
    """Return the law of single samples, at the place that holds most of what is in them."""
    energy = float(((rest.z[chosen] ** 2).sum() - chosen.sum() * rest.z.shape[1]) / whole)
    law, axes = "samples", tuple(AXES)
    if sensors is None:
        law, sensors, axes = law_of(rest, chosen)
        law = law if energy >= LEAST_SHARE else "samples"
    # From one sample in a hundred on it is stated, however little they change.
    certain = chosen.sum() if energy >= LEAST_SHARE or chosen.mean() > NEGLIGIBLE else 0.0
    times = tuple(rest.time_s[chosen].tolist())
    places = _of_scatter(sensors, rest, chosen)
    return Signature(law, "random", places[0], axes, float(np.clip(energy, 0, 1)), places, None, times, float(certain))


def _of_noise(scattered: list[Signature], rest: Residual) -> Signature:
    """Return the best law of scatter, with the places of those that are about as good."""
    best = scattered[0]
    near = [one.sensors for one in scattered[1:] if one.evidence >= best.evidence - TIE]
    places = tuple(dict.fromkeys((*_of_scatter(best.sensors, rest), *near)))
    if best.law == "noise" and (drive := noise_follows(rest, best.sensors, best.axes)):
        best = replace(best, course="motion" if drive == "motion" else "channel", follows=drive)
    return replace(best, sensors=places[0], places=places)


def _of_scatter(place: Place, rest: Residual, chosen: NDArray[np.bool_] | None = None) -> tuple[Place, ...]:
    """Return the places in which scatter may sit that was found in one, in all samples or in those chosen (N,)."""
    if place != SCALAR:
        return (place,)
    signal = within(rest, place, rest.z)
    return places_of(place, signal if chosen is None else signal * chosen[:, None], rest)


def _lattice(residual: Residual) -> Signature | None:
    """Return the law of readings that lie on a coarse lattice, where that makes most of the gap."""
    lattices = find_lattices(residual.model.channels().residuals)
    variances = [one.variance for one in residual.model.findings if one.variance is not None]
    explained = {row for one in variances for row in np.flatnonzero(one)}
    rows = [one.row for one in lattices if one.row < 3 * residual.sensor_count and one.row not in explained]
    if not rows:
        return None
    information = (residual.response**2).sum(axis=1).mean(axis=0) / residual.unit_T**2
    energy = sum(one.step_T**2 / 12 * information[one.row] for one in lattices if one.row in rows) * residual.count
    # A lattice is told from a seventh of the noise.
    if energy < max(residual.excess, 0) / 4 or energy < residual.size / 50:
        return None
    sensors = tuple(sorted({row // 3 + 1 for row in rows}))
    axes = tuple(axis for at, axis in enumerate(AXES) if any(row % 3 == at for row in rows))
    share = float(np.clip(energy / max(residual.excess, energy), 0, 1))
    return Signature("own_field", "motion", sensors, axes, share, (sensors,), "motion", (), np.inf)


def _of_found(found: Found, residual: Residual, whole: float) -> Signature:
    best, pattern, places = found.best, found.shared.pattern, _places(found)
    times_s: tuple[float, ...] = ()
    if best.bins is not None and best.steps:
        # A step within a bin is one at each of its ends.
        is_first = np.diff(best.steps, prepend=-2) > (best.course == "step")
        starts = best.bins.order[np.array(best.steps)[is_first]]
        times_s = tuple(float(residual.time_s[row[row >= 0]].min()) for row in starts)
    # What goes with the direction of the field at the scalar is an offset, if all sensors feel it.
    is_field = pattern.sensors == SCALAR != places[0] and best.course != "motion"
    return Signature(
        "offset" if is_field else pattern.law,
        best.course,
        places[0],
        pattern.axes,
        min(found.predicted, max(found.residual.excess / found.residual.noise, 1.0)) / whole,
        places,
        pattern.follows or ("motion" if best.course == "motion" else None),
        times_s,
        best.evidence,
        curve_of(best, found.residual),
    )


def _places(found: Found) -> tuple[Place, ...]:
    best, shared = found.best, found.shared
    possible = places_of(shared.pattern.sensors, shared.signal(found.residual, found.residual), found.residual)
    if shared is not best:
        return *possible, *as_good_elsewhere(found.residual, best, shared.pattern.sensors)
    others = [one.pattern.sensors for one in found.others if one.pattern.sensors != SCALAR]
    return tuple(dict.fromkeys((*possible, *others)))


def _merged(laws: list[Law]) -> list[Law]:
    """Return the laws with those of the same sensors, or that follow the same with the same lag, as one."""
    merged: dict[tuple[object, ...], Law] = {}
    for law in laws:
        one = law.signature
        drives = [found.best.pattern.drive for found in law.found if one.course == "channel"]
        lag = tuple(drive.tobytes() for drive in drives if drive is not None)
        follows_one = one.course in ("channel", "constant")
        key = one.law, one.course, one.follows, lag if follows_one else one.sensors
        merged[key] = _joined(merged[key], law) if key in merged else law
    return list(merged.values())


def _joined(first: Law, second: Law) -> Law:
    one, other = first.signature, second.signature
    sensors = tuple(sorted({*one.sensors, *other.sensors}, key=str))
    signature = replace(
        one,
        sensors=sensors,
        axes=tuple(axis for axis in AXES if axis in {*one.axes, *other.axes}),
        energy=min(one.energy + other.energy, 1.0),
        places=one.places if sensors == one.sensors else (sensors,),
    )
    return Law(signature, first.part + second.part, first.found + second.found, first.whole)
