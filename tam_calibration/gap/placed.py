"""A gap that only the residual of the intensity shows, at the likeliest of the places in which it may sit."""

from collections.abc import Sequence
from dataclasses import replace

from tam_calibration.gap.laws.causes import acts_at, agrees
from tam_calibration.gap.laws.law import Place, Signature
from tam_calibration.gap.result import Cause, Gap


def placed(gap: Gap, laws: Sequence[Signature], places: Sequence[Place]) -> Gap:
    """Return a gap that only the residual of the intensity shows at the likeliest of its places, and so its causes.

    Parameters
    ----------
    gap : Gap
        With its causes.
    laws : sequence of Signature
        The strongest first.
    places : sequence of Place
        Of the strongest law.
    """
    causes = tuple(_moved(one, _place_of(one.fitted.effect, laws, places[0])) for one in gap.causes)
    sensors = {sensor for one in causes for sensor in one.sensors} or set(places[0])
    axes = () if sensors == set(places[0]) else gap.where.axes
    where = replace(gap.where, sensors=tuple(sorted(sensors, key=str)), axes=axes)
    return replace(gap, causes=causes, where=where)


def _place_of(effect: str, laws: Sequence[Signature], default: Place) -> Place:
    """Return the likeliest place of the strongest law of the intensity that an effect can make."""
    return next((law.places[0] for law in laws if law.is_common and agrees(effect, law)), default)


def _moved(cause: Cause, place: Place) -> Cause:
    """Return a cause that acts on the scalar at another place in which it may act."""
    is_there = "scalar" in cause.sensors and acts_at(cause.fitted.effect, place)
    return replace(cause, sensors=place, axes=()) if is_there else cause
