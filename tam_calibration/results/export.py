"""Calibrations in the form that other software reads, in its unit, sign and order, and what it cannot hold.

A reading r of a sensor becomes the field C (r - o) in the array frame. A consumer that has only a symmetric matrix
gets S of the polar decomposition C = R S: the intensity is exact, and the rotation R is left out.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import inv, norm, svd

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.removal import on_sensors
from tam_calibration.files.text_files import to_json
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_degrees, to_nanotesla


@dataclass(frozen=True, eq=False)
class Sensor:
    """The correction of one sensor: field = matrix × (reading - bias_T).

    Parameters
    ----------
    number : int
        Counted from 1.
    matrix : (3, 3) array
        From the reading without bias to the field in the array frame.
    bias_T : (3,) array
        Along the sensor's own axes, tesla.
    """

    number: int
    matrix: FloatArray
    bias_T: FloatArray


@dataclass(frozen=True)
class Loss:
    """A part of a calibration that a consumer cannot hold or does not use.

    Parameters
    ----------
    sentence : str
        The sensor, the part, and the size in nT.
    size_T : float
        Largest error of the field over all directions, at the intensity of the calibration, tesla; of an effect the
        root mean square.
    """

    sentence: str
    size_T: float


@dataclass(frozen=True)
class Export:
    """A calibration in a consumer's form: the content of each file, and what is lost."""

    texts: tuple[str, ...]
    losses: tuple[Loss, ...]


Steps = Iterable[tuple[str, Sensor]]
"""What is left out of a correction, one part after the other, and the correction that remains."""

_GAUSS_T = TESLA_PER_FIELD_UNIT["G"]


_PX4_LEAST_CHANGE = 0.01
"""Norm of the smallest change of offsets (gauss), scales or off-diagonals that PX4 adopts (Magnetometer.cpp)."""


def _bias_alone(sensor: Sensor) -> Steps:
    yield "scale factors, non-orthogonality and rotation are left out", replace(sensor, matrix=np.eye(3))


def _symmetric(sensor: Sensor) -> Steps:
    left, scale, right = svd(sensor.matrix)
    angle = 2 * np.arcsin(np.minimum(norm(left @ right - np.eye(3), 2) / 2, 1.0))
    kept = replace(sensor, matrix=right.T * scale @ right)
    yield f"a rotation of {to_degrees(float(angle)):.3f} deg is left out", kept


def _symmetric_in_range(sensor: Sensor) -> Steps:
    (rotation,) = _symmetric(sensor)
    yield rotation
    least, most = 0.1, 3.0  # range of CAL_MAGn_XSCALE in PX4's parameter reference
    kept = _with_diagonal(rotation[1], np.clip(np.diag(rotation[1].matrix), least, most))
    yield f"scales are limited to between {least} and {most}", kept


def _ignored_by_px4(sensor: Sensor) -> Steps:
    """Leave out changes from the values with which PX4 starts: offsets 0, scales 1, off-diagonals 0."""
    diagonal = np.diag(sensor.matrix)
    if norm(_off_diagonal(sensor)) <= _PX4_LEAST_CHANGE:
        sensor = replace(sensor, matrix=np.diag(diagonal))
        yield f"PX4 ignores off-diagonals of at most {_PX4_LEAST_CHANGE}", sensor
    if norm(diagonal - 1) <= _PX4_LEAST_CHANGE:
        sensor = _with_diagonal(sensor, np.ones(3))
        yield f"PX4 ignores scales within {_PX4_LEAST_CHANGE} of 1", sensor
    if norm(sensor.bias_T) <= _PX4_LEAST_CHANGE * _GAUSS_T:
        yield f"PX4 ignores offsets of at most {_PX4_LEAST_CHANGE} gauss", replace(sensor, bias_T=np.zeros(3))


def _off_diagonal(sensor: Sensor) -> FloatArray:
    """Return the elements xy, xz, yz of a symmetric matrix, in the order of PX4 and ArduPilot."""
    return sensor.matrix[np.triu_indices(3, 1)]


def _with_diagonal(sensor: Sensor, diagonal: FloatArray) -> Sensor:
    return replace(sensor, matrix=sensor.matrix + np.diag(diagonal - np.diag(sensor.matrix)))


def _comments(losses: Sequence[str], mark: str = "#") -> str:
    return "".join(f"{mark} {line}\n" for line in (f"Written by tam_calibration {__version__}", *losses))


def _parts(sensor: Sensor, offset: FloatArray, names: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield name, axis and value of each offset, diagonal and off-diagonal element."""
    parts = offset, np.diag(sensor.matrix), _off_diagonal(sensor)
    for name, values in zip(names, parts, strict=True):
        for axis, value in zip("XYZ", values, strict=True):
            yield name, axis, f"{value:.9f}"


def _px4(sensors: Sequence[Sensor], losses: Sequence[str]) -> str:
    """Write parameters of PX4 as QGroundControl loads them: vehicle, component, name, value, type 9 (float), by tabs.

    Field = rotation × scale × (reading - offset), offset in gauss; the rotation (CAL_MAGn_ROT) says how the sensor is
    mounted and is not written. Sensor 1 is CAL_MAG0. Sources: PX4 ``src/lib/sensor_calibration/Magnetometer.hpp``,
    QGroundControl's "Parameters File Format".
    """
    lines = (
        f"1\t1\tCAL_MAG{sensor.number - 1}_{axis}{name}\t{value}\t9\n"
        for sensor in sensors
        for name, axis, value in _parts(sensor, sensor.bias_T / _GAUSS_T, ("OFF", "SCALE", "ODIAG"))
    )
    return _comments(losses) + "".join(lines)


def _ardupilot(sensors: Sequence[Sensor], losses: Sequence[str]) -> str:
    """Write parameters of ArduPilot, ``NAME,VALUE``.

    Field = matrix × COMPASS_SCALE × (reading + offset): the offset is in milligauss, and added. Compasses 2 and 3 have
    their number in the names. Source: ArduPilot ``libraries/AP_Compass/AP_Compass_Backend.cpp``, ``correct_field``.
    """
    text = _comments(losses)
    for sensor in sensors:
        number = "" if sensor.number == 1 else sensor.number
        parts = _parts(sensor, -1e3 * sensor.bias_T / _GAUSS_T, ("OFS", "DIA", "ODI"))
        text += "".join(f"COMPASS_{name}{number}_{axis},{value}\n" for name, axis, value in parts)
        text += f"COMPASS_SCALE{number},1\n"
    return text


def _imu_tools(sensors: Sequence[Sensor], losses: Sequence[str]) -> str:
    """Write parameters of imu_filter_madgwick, which takes one sensor and subtracts ``mag_bias``, tesla.

    Source: imu_tools ``imu_filter_madgwick/src/imu_filter_ros.cpp``, ``imuMagCallback``.
    """
    (sensor,) = sensors
    biases = dict(zip(("mag_bias_x", "mag_bias_y", "mag_bias_z"), sensor.bias_T.tolist(), strict=True))
    return _comments(losses) + dump_mapping({"/**": {"ros__parameters": biases}})


def _microstrain(sensors: Sequence[Sensor], losses: Sequence[str]) -> str:
    """Write what ``microstrain-mag-cal-apply`` sends to a device: field = matrix × (reading - offset), gauss.

    Source: HBK-MicroStrain/microstrain_mag_cal ``lib/microstrain_mag_cal/calibration.cpp``, ``deserializeFitResult``.
    """
    (sensor,) = sensors
    names = [row + column for row in "xyz" for column in "xyz"]
    matrix = dict(zip(names, sensor.matrix.ravel().tolist(), strict=True))
    offset = dict(zip("xyz", (sensor.bias_T / _GAUSS_T).tolist(), strict=True))
    return to_json({"error": "NONE", "softIronMatrix": matrix, "hardIronOffset": offset}) + "\n"


def _c(sensors: Sequence[Sensor], losses: Sequence[str]) -> str:
    """Write a C header; its comment has the formula."""
    formula = "field[i] = sum over j of tam_matrix[k][i][j] * (reading[j] - tam_bias_nT[k][j]), in nT, of sensor k + 1"
    biases = ",\n    ".join(_braces(to_nanotesla(sensor.bias_T)) for sensor in sensors)
    matrices = ",\n    ".join("{" + ",\n     ".join(map(_braces, sensor.matrix)) + "}" for sensor in sensors)
    return f"""/*
{_comments([formula, *losses], " *")} */
#ifndef TAM_CALIBRATION_H
#define TAM_CALIBRATION_H

#define TAM_SENSORS {len(sensors)}

static const float tam_bias_nT[TAM_SENSORS][3] = {{
    {biases}
}};

static const float tam_matrix[TAM_SENSORS][3][3] = {{
    {matrices}
}};

#endif
"""


def _braces(values: FloatArray) -> str:
    return "{" + ", ".join(f"{value:.9e}f" for value in values) + "}"


def _json(sensors: Sequence[Sensor], losses: Sequence[str]) -> str:
    """Write JSON in SI, with the formula."""
    blocks = [
        {"sensor": sensor.number, "bias_T": sensor.bias_T.tolist(), "correction_matrix": sensor.matrix.tolist()}
        for sensor in sensors
    ]
    formula = "field in the array frame [T] = correction_matrix × (reading [T] - bias_T)"
    software = f"tam_calibration {__version__}"
    return to_json({"software": software, "formula": formula, "left_out": losses, "sensors": blocks}) + "\n"


@dataclass(frozen=True)
class Consumer:
    """Software that reads a calibration.

    Parameters
    ----------
    suffix : str
        Of the names of its files.
    write : callable
        Makes the text of a file from sensors and sentences on losses.
    limits : callable, optional
        Leaves out of a correction what the file cannot hold.
    ignores : callable, optional
        Leaves out of a correction what the file contains but the consumer does not use.
    most_sensors : int
        How many sensors it reads.
    is_of_one_sensor : bool
        Whether each sensor has its own file.
    """

    suffix: str
    write: Callable[[Sequence[Sensor], Sequence[str]], str]
    limits: Callable[[Sensor], Steps] = lambda sensor: ()
    ignores: Callable[[Sensor], Steps] = lambda sensor: ()
    most_sensors: float = np.inf
    is_of_one_sensor: bool = False


CONSUMERS = {
    "px4": Consumer(".params", _px4, _symmetric_in_range, _ignored_by_px4, most_sensors=4),
    "ardupilot": Consumer(".param", _ardupilot, _symmetric, most_sensors=3),
    "imu_tools": Consumer(".yaml", _imu_tools, _bias_alone, is_of_one_sensor=True),
    "microstrain": Consumer(".json", _microstrain, is_of_one_sensor=True),
    "c": Consumer(".h", _c),
    "json": Consumer(".json", _json),
}
"""By the names of ``tam export --to``."""


def export(calibration: Calibration, target: str) -> Export:
    """Return a calibration in the form that a consumer reads, and what is lost.

    Parameters
    ----------
    calibration : Calibration
        Of K sensors.
    target : str
        A name in `CONSUMERS`, such as "px4" or "json".

    Returns
    -------
    Export
        One text, or one for each sensor.

    Examples
    --------
    >>> from tam_calibration import calibrate, export, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> exported = export(calibrate(made.recording, made.scenario.array), "c")
    >>> len(exported.texts), exported.losses
    (1, ())
    """
    consumer = CONSUMERS[target]
    losses = list(_effects(calibration))
    kept = []
    for number, matrix in enumerate(inv(calibration.errors.matrix), start=1):
        exact = Sensor(number, matrix, calibration.errors.bias_T[number - 1])
        if number > consumer.most_sensors:
            steps = [(f"{target} reads only {consumer.most_sensors} sensors", Sensor(number, np.eye(3), np.zeros(3)))]
        else:
            steps = list(consumer.limits(exact))
            kept.append(steps[-1][1] if steps else exact)
            steps += consumer.ignores(kept[-1])
        losses += _losses(exact, steps, calibration.intensity_T)
    groups = [[sensor] for sensor in kept] if consumer.is_of_one_sensor else [kept]
    sentences = [loss.sentence for loss in losses]
    return Export(tuple(consumer.write(group, sentences) for group in groups), tuple(losses))


def _effects(calibration: Calibration) -> Iterator[Loss]:
    for fitted, size in zip(calibration.effects, calibration.effect_sizes, strict=True):
        if on_sensors(fitted):
            rms_T = float(norm(size.rms[:3]))
            yield Loss(f"the effect {fitted.effect} is left out, {to_nanotesla(rms_T):.2f} nT RMS", rms_T)


def _losses(exact: Sensor, steps: Steps, intensity_T: float) -> Iterator[Loss]:
    """Yield the size of each step: the field b makes the reading C⁻¹ b + o, which is corrected before and after it."""
    before = exact
    for what, after in steps:
        of_matrix = norm((after.matrix - before.matrix) @ inv(exact.matrix), 2) * intensity_T
        size_T = float(of_matrix + norm(after.matrix @ (before.bias_T - after.bias_T)))
        before = after
        # Sizes are written in hundredths of a nT.
        if size_T > 5e-12:
            yield Loss(f"sensor {exact.number}: {what}, up to {to_nanotesla(size_T):.2f} nT", size_T)
