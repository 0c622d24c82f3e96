"""The array file: positions and noise of the sensors, with units in the keys."""

from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.files.text_files import nanotesla_to_write, write_whole
from tam_calibration.files.yaml_document import Document, check, dump_mapping, mapping_in
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.units import from_nanotesla

_Offsets = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


class ArrayFile(Document):
    """What an array file may hold; a noise that is not stated is estimated from the recording.

    Parameters
    ----------
    baseline_m : float, optional
        Distance between opposite sensors of a four-sensor cross; either this or the positions.
    positions_m : list of [x, y, z], optional
        Positions in the array frame, x forward, y left, z up.
    vector_noise_nT : float or list of float, optional
        Noise of each axis, one for all sensors or one for each.
    scalar_noise_nT : float, optional
        Noise of the scalar magnetometer.
    scalar_position_m : [x, y, z], optional
        Where the scalar magnetometer sits when it is not at the centre.
    axis_offsets_m : list of three [x, y, z], optional
        For each sensor where the elements of its axes x, y and z sit beside its position; ``tam calibrate --source``
        finds them.
    intensity_nT : [low, high], optional
        What the intensity of the field can be in which the array is turned, where it is not the Earth's alone: that of
        a coil or a shielded room.
    delay_s : list of float, optional
        How much later than it was read a reading of each sensor is stamped, s; ``tam calibrate --estimate-delays``
        finds them.
    notes, recording
        Anything; not read.
    """

    baseline_m: float | None = None
    positions_m: list[tuple[float, float, float]] | None = None
    vector_noise_nT: float | list[float] | None = None
    scalar_noise_nT: float | None = None
    scalar_position_m: tuple[float, float, float] | None = None
    axis_offsets_m: list[_Offsets] | None = None
    intensity_nT: tuple[float, float] | None = None
    delay_s: list[float] | None = None
    notes: Any = None
    recording: Any = None

    def to_array(self) -> Array:
        """Return the array.

        Raises
        ------
        InputError
            When positions or noise make no array.
        """
        if (self.baseline_m is None) == (self.positions_m is None):
            raise InputError("give either baseline_m (the cross) or positions_m (a row of x, y, z for each sensor)")
        array = Array.cross(self.baseline_m) if self.baseline_m is not None else Array(np.array(self.positions_m))
        vector_noise_T = None
        if self.vector_noise_nT is not None:
            stated = np.asarray(self.vector_noise_nT, dtype=float)
            vector_noise_T = from_nanotesla(np.full(array.sensor_count, stated) if stated.ndim == 0 else stated)
        field = EARTH_FIELD
        if self.intensity_nT is not None:
            low_nT, high_nT = self.intensity_nT
            field = FieldBounds(from_nanotesla(low_nT), from_nanotesla(high_nT))
        return Array(
            array.positions_m,
            vector_noise_T,
            None if self.scalar_noise_nT is None else from_nanotesla(self.scalar_noise_nT),
            None if self.scalar_position_m is None else np.array(self.scalar_position_m),
            None if self.axis_offsets_m is None else np.array(self.axis_offsets_m),
            field,
            None if self.delay_s is None else np.array(self.delay_s),
        )


def read_array(path: str | Path) -> Array:
    """Read an array file.

    Parameters
    ----------
    path : str or Path
        The YAML file: ``baseline_m`` of a cross or ``positions_m``, metres, and the noise in nT where it is known.

    Returns
    -------
    Array
        In SI; a noise that the file does not state is None.

    Raises
    ------
    InputError
        When it cannot be read, a key is not known, or the values make no array.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tam_calibration import read_array
    >>> written = Path("cross.yaml").write_text("{baseline_m: 0.5, vector_noise_nT: 1.0}")
    >>> array = read_array("cross.yaml")
    >>> array.sensor_count, array.vector_noise_T
    (4, array([1.e-09, 1.e-09, 1.e-09, 1.e-09]))
    """
    with mapping_in(Path(path)) as content:
        return _array_from_mapping(content)


def _array_from_mapping(content: dict[str, Any]) -> Array:
    """Return the array of the keys and values of an array file.

    Raises
    ------
    InputError
        When a key is not known, or the values make no array.
    """
    return check(content, ArrayFile).to_array()


def array_to_mapping(array: Array) -> dict[str, Any]:
    """Return the keys and values of an array file."""
    content: dict[str, Any] = {"positions_m": array.positions_m.tolist()}
    if array.vector_noise_T is not None:
        content["vector_noise_nT"] = nanotesla_to_write(array.vector_noise_T).tolist()
    if array.scalar_noise_T is not None:
        content["scalar_noise_nT"] = float(nanotesla_to_write(np.array(array.scalar_noise_T)))
    if array.scalar_position_m is not None:
        content["scalar_position_m"] = array.scalar_position_m.tolist()
    if array.axis_offsets_m is not None:
        content["axis_offsets_m"] = array.axis_offsets_m.tolist()
    if array.delay_s is not None:
        content["delay_s"] = array.delay_s.tolist()
    if array.field != EARTH_FIELD:
        content["intensity_nT"] = nanotesla_to_write(np.array([array.field.low_T, array.field.high_T])).tolist()
    return content


def write_array(path: Path, array: Array) -> None:
    """Write an array file.

    Parameters
    ----------
    path : Path
        The YAML file; one that is there is replaced once the new one is whole.
    array : Array
        Its positions are written in metres, its noise in nT where it is known.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    with write_whole(path) as beside:
        beside.write_text(dump_mapping(array_to_mapping(array)), encoding="utf-8")
