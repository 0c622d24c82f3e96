"""What attitude or angular velocity must offer as data: a term of the likelihood with unknowns of its own."""

from typing import Any, Protocol, Self

import numpy as np

from tam_calibration.core.normal_equations import Normal
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


class MotionState(Protocol):
    """The unknowns of the motion at a point."""

    @property
    def mount(self) -> FloatArray:
        """(3, 3) rotation between the frame of the sensors and that of the motion."""

    @property
    def mounting(self) -> tuple[FloatArray, float]:
        """Rotation from the frame of the sensors to that of the motion, and the sign of its turn by ``mount``."""

    @property
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def turn(self) -> slice:
        """Place of the turn of ``mount`` among them."""

    def moved(self, step: FloatArray) -> Self:
        """Return the state after a step (size,)."""


class Motion(Protocol):
    """Samples whose motion was recorded; a state is one of its own kind."""

    @property
    def sample_count(self) -> int:
        """Number of samples."""

    def part(self, samples: slice) -> Self:
        """Return some of the samples."""

    def start(self, errors: SensorErrors) -> MotionState:
        """Return the state at which a fit begins."""

    def linearize(self, matrix: FloatArray, bias: FloatArray, state: Any) -> Normal:
        """Return the normal equations over the rows [D Λ | o] of the sensors and the unknowns of the state."""

    def scatter(self, matrix: FloatArray, bias: FloatArray, state: Any, taken: float = 0.0) -> float:
        """Return the noise of the motion that the residuals show, so many channels being taken by the fit."""

    def prior(self, state: Any, main_field_T: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return the precisions of the unknowns before the samples, and the downhill gradient."""

    def is_free(self, state: Any) -> np.ndarray:
        """Return which of the unknowns are fitted."""
