"""Recursions over samples: first-order lags, x' = (drive - x) / τ, and their state from batch to batch."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.units import FloatArray


class Memory:
    """The states of the recursions of an effect's terms between batches of samples.

    Each batch runs the same recursions in the same order, so that they need no names: each recalls its state at the end
    of the previous batch, and keeps that for the next.
    """

    def __init__(self) -> None:
        self._kept: list[Any] = []
        self._turn = 0

    def rewind(self) -> None:
        """Begin a batch, at the first recursion."""
        self._turn = 0

    def recall(self) -> Any:
        """Return the state of the current recursion after the previous batch; None in the first batch."""
        return self._kept[self._turn] if self._turn < len(self._kept) else None

    def keep(self, value: Any) -> None:
        """Keep a state for the next batch, and go on to the next recursion."""
        self._kept[self._turn : self._turn + 1] = [value]
        self._turn += 1


def lagged(drive: FloatArray, time_s: FloatArray, time_constant_s: float, memory: Memory | None = None) -> FloatArray:
    """Return a drive (N,) or (N, C) after a first-order lag, exact for a drive that is linear between samples.

    The lag is settled at the first sample, or goes on from where it stood in its memory; sample n depends on none
    after it.

    Parameters
    ----------
    drive : (N,) or (N, C) array
        Quantity that is lagged, in any unit.
    time_s : (N,) array
        Increasing times, seconds.
    time_constant_s : float
        Of the lag, seconds; where it is not positive there is no lag.
    memory : Memory, optional
        State after the previous batch of samples.
    """
    if time_constant_s <= 0:
        return drive.copy()
    before = None if memory is None else memory.recall()
    if before is None:
        state = _lagged(drive, time_s, time_constant_s, drive[:1])
    else:
        last_time, last_drive, last_state = before
        values, times = np.concatenate([last_drive, drive]), np.concatenate([last_time, time_s])
        state = _lagged(values, times, time_constant_s, last_state)[1:]
    if memory is not None:
        memory.keep((time_s[-1:], drive[-1:], state[-1:]))
    return state


def _lagged(drive: FloatArray, time_s: FloatArray, time_constant_s: float, initial: FloatArray) -> FloatArray:
    values = drive.reshape(len(drive), -1)
    step = np.diff(time_s)[:, None]
    behind = time_constant_s * np.diff(values, axis=0) / step
    first = initial.reshape(-1)
    return follow(values[1:] - behind, values[:-1] - behind, first, step / time_constant_s).reshape(drive.shape)


def lagged_smooth(drive: FloatArray, rate: FloatArray, time_s: FloatArray, time_constant_s: float) -> FloatArray:
    """Return a drive (N, C) with known rates of change after a first-order lag, exact for cubics between samples.

    Right for time constants below the step of time too, which ``lagged`` takes for a lag of half a step.

    Parameters
    ----------
    drive : (N, C) array
        Quantity that is lagged, in any unit.
    rate : (N, C) array
        Its time derivative, per second.
    time_s : (N,) array
        Increasing times, seconds.
    time_constant_s : float
        Of the lag, seconds; where it is not positive there is no lag.
    """
    if time_constant_s <= 0 or len(drive) < 2:
        return drive.copy()
    return mode(drive, rate, time_s, time_constant_s)


def mode(drive: FloatArray, rate: FloatArray, time_s: FloatArray, tau: complex) -> NDArray[Any]:
    """Return x (N, C) of x' = (drive - x) / τ, settled at first, exact for cubics between samples.

    A complex time constant, of positive real part, is that of an oscillation.

    Parameters
    ----------
    drive : (N, C) array
        Quantity that drives the mode, in any unit.
    rate : (N, C) array
        Its time derivative, per second.
    time_s : (N,) array
        Increasing times, seconds.
    tau : complex
        Time constant τ, seconds.
    """
    step = np.diff(time_s)[:, None]
    slope = np.diff(drive, axis=0) / step
    first, last = rate[:-1], rate[1:]
    third = 6 * (first + last - 2 * slope) / step**2
    second = 2 * (3 * slope - 2 * first - last) / step
    second_at_end = second + third * step
    # A cubic p is followed by p - τ p' + τ² p'' - τ³ p''' and a transient.
    end = drive[1:] - tau * (last - tau * (second_at_end - tau * third))
    start = drive[:-1] - tau * (first - tau * (second - tau * third))
    return follow(end, start, drive[0] - tau * rate[0], step / tau)


def follow(end: NDArray[Any], start: NDArray[Any], initial: NDArray[Any], ratio: NDArray[Any]) -> NDArray[Any]:
    """Return x (N, C) of x_n = end_n + exp(-ratio_n) (x_{n-1} - start_n).

    Ends and starts are (N - 1, C), of the samples after the first; ratios the same or (N - 1, 1).

    Parameters
    ----------
    end, start : (N - 1, C) array
        Particular solution at the end and at the start of each step.
    initial : (C,) array
        State x at the first sample.
    ratio : (N - 1, C) or (N - 1, 1) array
        Exponent of the decay in each step; its real part is not negative.
    """
    decay = np.exp(-ratio)
    state = np.concatenate([initial[None], end - decay * start])
    if decay.shape[1] == 1:
        return _followed(state, decay[:, 0])
    return np.column_stack([_followed(*each) for each in zip(state.T, decay.T, strict=True)])


def _followed(added: NDArray[Any], decay: NDArray[Any]) -> NDArray[Any]:
    """Return x of x_n = decay_n x_{n-1} + added_n: the solution of equations of two diagonals."""
    from scipy.linalg.lapack import get_lapack_funcs

    diagonals = np.ones((2, len(added)), dtype=decay.dtype)
    diagonals[1, :-1] = -decay
    (solve,) = get_lapack_funcs(("tbtrs",), (diagonals, added))
    followed: NDArray[Any] = solve(diagonals, added, uplo="L", diag="U")[0]
    return followed
