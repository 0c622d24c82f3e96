"""Recursions over samples, whose state goes from batch to batch: lags, oscillations, play, loops and relays."""

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

    def recall(self, first: Any) -> Any:
        """Return the state of the current recursion after the previous batch; in the first batch the one given."""
        return self._kept[self._turn] if self._turn < len(self._kept) else first

    def keep(self, value: Any) -> None:
        """Keep a state for the next batch, and go on to the next recursion."""
        self._kept[self._turn : self._turn + 1] = [value]
        self._turn += 1


_NO_LAG_S = 1e-9
"""Longest time constant that is none, seconds: samples are a microsecond apart at least."""


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
        Of the lag, seconds; up to a nanosecond there is no lag.
    memory : Memory, optional
        State after the previous batch of samples.
    """
    if time_constant_s <= _NO_LAG_S:
        return drive.copy()
    memory = memory or Memory()
    last_time, last_drive, state = memory.recall((time_s[:0], drive[:0], drive[:1]))
    times, values = np.concatenate([last_time, time_s]), np.concatenate([last_drive, drive])
    columns, step = values.reshape(len(values), -1), np.diff(times)[:, None]
    behind = time_constant_s * np.diff(columns, axis=0) / step
    late = follow(columns[1:] - behind, columns[:-1] - behind, state.ravel(), step / time_constant_s)
    late = late.reshape(values.shape)[len(last_time) :]
    memory.keep((times[-1:], values[-1:], late[-1:]))
    return late


def mode(
    drive: FloatArray, rate: FloatArray, time_s: FloatArray, tau: complex, initial: NDArray[Any] | None = None
) -> NDArray[Any]:
    """Return x (N, C) of x' = (drive - x) / τ, exact for cubics between samples.

    A real time constant is that of a lag, a complex one of positive real part that of an oscillation. It may be shorter
    than the step of time, where ``lagged`` is a lag of half a step.

    Parameters
    ----------
    drive : (N, C) array
        Quantity that drives the mode, in any unit.
    rate : (N, C) array
        Its time derivative, per second.
    time_s : (N,) array
        Increasing times, seconds.
    tau : complex
        Time constant τ, seconds; up to a nanosecond there is no lag.
    initial : (C,) array, optional
        State x at the first sample; by default the mode is settled.
    """
    if tau.imag == 0 and tau.real <= _NO_LAG_S:
        return drive.copy()
    step = np.diff(time_s)[:, None]
    slope = np.diff(drive, axis=0) / step
    first, last = rate[:-1], rate[1:]
    third = 6 * (first + last - 2 * slope) / step**2
    second = 2 * (3 * slope - 2 * first - last) / step
    second_at_end = second + third * step
    # A cubic p is followed by p - τ p' + τ² p'' - τ³ p''' and a transient.
    end = drive[1:] - tau * (last - tau * (second_at_end - tau * third))
    start = drive[:-1] - tau * (first - tau * (second - tau * third))
    return follow(end, start, drive[0] - tau * rate[0] if initial is None else initial, step / tau)


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
    return np.asarray(solve(diagonals, added, uplo="L", diag="U")[0])


def rounded_loop(drive: FloatArray, width: float, memory: Memory | None = None) -> FloatArray:
    """Return x (N, R) of dx = ds - |ds| x / width for drives s (N, R), from rest at zero (Dahl's model of friction).

    Parameters
    ----------
    drive : (N, R) array
        Field that drives each of R loops, tesla.
    width : float
        Path of the drive over which a loop settles, tesla.
    memory : Memory, optional
        State after the previous batch of samples; by default the loops start from rest.
    """
    memory = memory or Memory()
    path, state = memory.recall((drive[:1], np.zeros(drive.shape[1])))
    change = np.diff(np.concatenate([path, drive]), axis=0)
    limit = width * np.sign(change)
    loop = follow(limit, limit, state, np.abs(change) / width)[1:]
    memory.keep((drive[-1:], loop[-1]))
    return loop


def play(drive: FloatArray, widths: FloatArray, memory: Memory | None = None) -> FloatArray:
    """Return the states (N, R, W) of play operators of half-widths (W,) that drives (N, R) push.

    They start from rest at zero, or from where they stood in their memory.

    p_n = min(s_n + w, max(s_n - w, p_{n-1})). Such steps in a row are one step of the same kind, so that blocks of
    samples are worked through side by side: first from the extremes, which tells what each makes of any state before,
    then what all blocks up to each make of the first, by doubling their reach.

    Parameters
    ----------
    drive : (N, R) array
        Field that pushes the operators, tesla.
    widths : (W,) array
        Half-widths w, tesla.
    memory : Memory, optional
        State after the previous batch of samples; by default the operators start from rest.
    """
    count = len(drive)
    length = max(int(np.cbrt(count)), 1)
    padded = np.concatenate([drive, np.repeat(drive[-1:], -count % length, axis=0)])
    blocks = padded.reshape(-1, length, drive.shape[1], 1)

    def pushed(state: FloatArray, step: int) -> FloatArray:
        now = blocks[:, step]
        return np.minimum(now + widths, np.maximum(now - widths, state))

    shape = (len(blocks), drive.shape[1], len(widths))
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    for step in range(length):
        low, high = pushed(low, step), pushed(high, step)
    reach = 1
    while reach < len(blocks):
        last = low[reach:].copy(), high[reach:].copy()
        low[reach:], high[reach:] = (np.clip(own[:-reach], *last) for own in (low, high))
        reach *= 2
    memory = memory or Memory()
    first = memory.recall(np.zeros(shape[1:]))
    state: FloatArray = np.concatenate([first[None], np.clip(first, low[:-1], high[:-1])])
    states = np.empty((len(blocks), length, *shape[1:]))
    for step in range(length):
        state = pushed(state, step)
        states[:, step] = state
    memory.keep(state[-1])
    return states.reshape(-1, *shape[1:])[:count]


def relays(sizes: FloatArray, upper: float, lower: float, memory: Memory | None = None) -> NDArray[np.bool_]:
    """Return whether relays (N, R) are on: from above the upper threshold on, until below the lower; off at first.

    Parameters
    ----------
    sizes : (N, R) array
        What drives each of R relays.
    upper, lower : float
        Thresholds, in the unit of the sizes.
    memory : Memory, optional
        State after the previous batch of samples; by default the relays start off.
    """
    memory = memory or Memory()
    before = memory.recall(np.zeros(sizes.shape[1], dtype=bool))
    event = np.vstack([np.where(before, 1, -1), np.where(sizes > upper, 1, np.where(sizes < lower, -1, 0))])
    last = np.maximum.accumulate(np.where(event != 0, np.arange(len(event))[:, None], 0))
    are_on: NDArray[np.bool_] = np.take_along_axis(event, last, axis=0)[1:] > 0
    memory.keep(are_on[-1])
    return are_on
