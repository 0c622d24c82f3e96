"""Further channels of a vehicle by name: the currents of its circuits, and what its actuators do.

A name is that of a column, and implies the topic: ``current_2_A``, the second current, is ``currents/current_2``, and
``actuator_rudder`` is ``actuators/rudder``: an angle, a speed or a power in whatever unit. The first current is the
channel ``current_A`` of old.
"""

import re
from collections.abc import Iterable

from tam_calibration.model.exceptions import InputError, quoted

_COLUMN = re.compile(r"(current_(?:[2-9]|[1-9]\d))_A|actuator_([a-z][a-z0-9_]{0,40})")
_TOPIC = re.compile(r"currents/(current_(?:[2-9]|[1-9]\d))|actuators/([a-z][a-z0-9_]{0,40})")


def is_further(name: str) -> bool:
    """Whether a name is that of a further channel."""
    return _COLUMN.fullmatch(name) is not None


def unit_of(name: str) -> str:
    """Return the unit of a further channel: A of a current, 1 of an actuator."""
    return "A" if name.startswith("current") else "1"


def topic_of(name: str) -> str:
    """Return the relative topic of a further channel, messages of which hold one number."""
    match = _COLUMN.fullmatch(name)
    assert match is not None
    return f"currents/{match[1]}" if match[1] else f"actuators/{match[2]}"


def named_by(topic: str) -> str | None:
    """Return the name of the further channel with a relative topic; None where it is another topic."""
    match = _TOPIC.fullmatch(topic)
    if match is None:
        return None
    return f"{match[1]}_A" if match[1] else f"actuator_{match[2]}"


def require_further(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of further channels, each once, in the order of columns.

    Raises
    ------
    InputError
        When one is none.
    """
    given = list(names)
    for name in given:
        if not is_further(name):
            raise InputError(
                f"{quoted(name)} is no further channel: one is named current_2_A to current_99_A, or actuator_ and a "
                "name in small letters"
            )
    return tuple(sorted(set(given), key=lambda name: (not name.startswith("current"), len(name), name)))


def channel_in_words(name: str) -> str:
    """Return a channel as sentences name it: "current" of current_A, and a further one by its column."""
    if name == "angular_velocity_rad_s":
        return "gyroscope"
    return name if is_further(name) else name.partition("_")[0]
