"""What a calibrator has learned, on disk, so that one that is started anew goes on: arrays and a text about them.

A line with a checksum of what follows precedes them.
"""

import json
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from tam_calibration.files.text_files import write_whole
from tam_calibration.live.live import Change, LiveState
from tam_calibration.live.recursion import Belief, Recursion, SampleMoments
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.sensor_errors import SensorErrors

_HEAD = b"tam live %08x\n"
"""What files begin with."""

_BELIEFS = ("begin", "now", "published")


def write_live_state(path: Path, state: LiveState, calibration: str) -> None:
    """Write a state; a file that is there is replaced once the new one is complete.

    Parameters
    ----------
    path : Path
        Of the file.
    state : LiveState
        What was learned.
    calibration : str
        Text of the calibration file that it began with.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    recursion = state.recursion
    about = {
        "calibration": calibration,
        "paused_by": state.paused_by,
        "learned": state.learned,
        "energy": state.energy,
        "freedom": state.freedom,
        "count": recursion.moments.count,
        "scalar_count": recursion.moments.scalar_count,
        "changes": [asdict(change) for change in state.changes],
    }
    arrays: dict[str, Any] = {"second": recursion.moments.second, "fourth": recursion.moments.fourth}
    for name, belief in zip(_BELIEFS, (recursion.begin, recursion.now, state.published), strict=True):
        arrays[f"{name}_errors"], arrays[f"{name}_covariance"] = belief.errors.to_vector(), belief.covariance
        arrays[f"{name}_moment"] = np.array([belief.time_s, belief.temperature_C])
    arrays["orientation"] = recursion.begin.errors.orientation
    content = BytesIO()
    np.savez(content, about=np.array(json.dumps(about)), **arrays)
    with write_whole(path) as temporary:
        temporary.write_bytes(_HEAD % crc32(content.getvalue()) + content.getvalue())


def read_live_state(path: Path, sensor_count: int) -> tuple[LiveState, str]:
    """Return a state and the text of the calibration that it began with.

    Parameters
    ----------
    path : Path
        Of the file.
    sensor_count : int
        Of the array that it should be of.

    Raises
    ------
    InputError
        When it cannot be read, is damaged, or of another number of sensors.
    """
    try:
        with np.load(BytesIO(_checked_content(path.read_bytes())), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays.pop("about")))
        state = _state(arrays, about, sensor_count)
        calibration = str(about["calibration"])
    except Exception as problem:  # an archive of something else fails in any way
        raise InputError(f"{path} contains nothing that was learned of this array, or is damaged: {problem}") from None
    return state, calibration


def _checked_content(content: bytes) -> bytes:
    """Return what follows the checksum, if it fits."""
    rest = content[len(_HEAD % 0) :]
    if not content.startswith(_HEAD % crc32(rest)):
        raise ValueError("its checksum is not that of its content")
    return rest


def _state(arrays: dict[str, Any], about: dict[str, Any], sensor_count: int) -> LiveState:
    size, rows = 12 * sensor_count, 3 * sensor_count + 1
    second, fourth = _checked(arrays["second"], (rows, rows)), _checked(arrays["fourth"], (17, 17))
    orientation = _checked(arrays["orientation"], (sensor_count, 3, 3))
    beliefs = []
    for name in _BELIEFS:
        vector = _checked(arrays[f"{name}_errors"], (sensor_count, 12))
        covariance = _checked(arrays[f"{name}_covariance"], (size, size))
        if not is_covariance(covariance):
            raise ValueError(f"the covariance {name!r} is not positive definite")
        time_s, temperature_C = arrays[f"{name}_moment"].tolist()
        beliefs.append(Belief(SensorErrors.from_vector(vector, orientation), covariance, time_s, temperature_C))
    begin, now, published = beliefs
    moments = SampleMoments(second, fourth, int(about["count"]), int(about["scalar_count"]))
    return LiveState(
        Recursion(begin, moments, now),
        published,
        str(about["paused_by"]),
        int(about["learned"]),
        float(about["energy"]),
        float(about["freedom"]),
        tuple(Change(**{**each, "parameters": tuple(each["parameters"])}) for each in about["changes"]),
    )


def _checked(values: Any, shape: tuple[int, ...]) -> Any:
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"{shape} finite numbers were expected, and {values.shape} are there")
    return values
