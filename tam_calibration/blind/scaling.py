"""The amplitude at which a disturbance is seen with a wanted gap."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tam_calibration.blind.disturbance import Disturbance, Signal
from tam_calibration.blind.scene import Scene

NEAR = 0.01
"""Share by which the gap may differ from the one wanted."""

STEPS = 60


class Model(Protocol):
    """What a recording shows of a signal."""

    @property
    def scene(self) -> Scene:
        """The recording."""

    def visible_gap(self, signal: Signal) -> float:
        """Return what is left of a signal by the nominal fit, in noise floors."""


@dataclass(frozen=True, eq=False)
class Scaled:
    """A disturbance at an amplitude, with what it adds and how much of that is seen."""

    disturbance: Disturbance
    amplitude: float
    signal: Signal
    visible_gap: float


def scale_to(model: Model, disturbance: Disturbance, gap: float, seen: Signal) -> Scaled | None:
    """Return the disturbance at the amplitude that is seen with a gap; None when none is.

    The gap grows with the amplitude, for most in proportion; the search keeps to the bracket that it knows.
    """
    low, high, amplitude = 0.0, np.inf, _start(model, disturbance)
    for _ in range(STEPS):
        signal = disturbance.change(amplitude, seen)
        visible = model.visible_gap(signal)
        if abs(visible / gap - 1) < NEAR:
            return Scaled(disturbance, amplitude, signal, visible)
        low, high = (amplitude, high) if visible < gap else (low, amplitude)
        guess = amplitude * (np.clip(gap / visible, 0.1, 10) if visible > 0 else 10)
        inside = low < guess < high
        amplitude = float(guess if inside else np.sqrt(max(low, high * 1e-3) * high))
        if high < low * (1 + 1e-9) or not np.isfinite(amplitude):
            break
    return None


def _start(model: Model, disturbance: Disturbance) -> float:
    """Return an amplitude to begin with: the noise for what is in tesla, the natural one for the rest."""
    if disturbance.amplitude_unit.startswith("T "):
        return model.scene.vector_noise_T
    return 1e-4 if disturbance.amplitude_unit.startswith("rad") else 1.0 if "nT" in disturbance.amplitude_unit else 1e-3
