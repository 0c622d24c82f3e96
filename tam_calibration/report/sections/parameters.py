"""The parameters with their standard errors, and how to apply them by hand."""

from numpy.linalg import inv

from tam_calibration.array import OUTPUT_NAMES
from tam_calibration.calibration import Calibration
from tam_calibration.report.effect_rows import NUMBERS_HEADER, effect_number_rows, effect_size_header, effect_size_rows
from tam_calibration.report.evidence import NO_GRADIENT, Evidence
from tam_calibration.report.formatting import fixed
from tam_calibration.report.page import Block, Formula, Section, Table, Text
from tam_calibration.report.parameter_rows import parameter_rows
from tam_calibration.units import to_nanotesla

_MODEL = (
    "Value ± standard error. The model is yᵢ = Dᵢ Λᵢ bᵢ + oᵢ: D holds scale factors and non-orthogonality, "
    "Λ the misalignment, o the bias."
)
_EFFECTS = (
    "Effects, fitted together with the errors of the sensors, whose standard errors hold what is not known of them."
)
_SIZES = "Root mean square, over the recording, of what the effects add to each output, and what is taken off it."
_SENSOR_BY_HAND = "By hand, the reading yᵢ of sensor i becomes the field bᵢ in the array frame by"
_ARRAY_BY_HAND = "Field and gradient at the centre are sums over the sensors, with the weights of the array's geometry:"
_WEIGHTS = "Weights W (no unit) of the centre field and G (1/m) of the gradient; empty where a reading does not count."


def build(evidence: Evidence) -> Section:
    """Return the section."""
    calibration = evidence.calibration
    blocks: list[Block] = [_parameters(calibration), *_effects(calibration)]
    blocks += [Text(statement) for statement in calibration.statements]
    blocks += [Text(_SENSOR_BY_HAND), Formula(["bᵢ = Cᵢ (yᵢ − oᵢ),   Cᵢ = (Dᵢ Λᵢ)⁻¹"]), _matrices(calibration)]
    if calibration.array.has_gradient:
        blocks += [Text(_ARRAY_BY_HAND), Formula(["b = Σᵢ Wᵢ bᵢ,   g = Σᵢ Gᵢ bᵢ"]), _weights(calibration)]
    else:
        blocks.append(Text(f"The field at the centre is the mean of all bᵢ. {NO_GRADIENT}"))
    return Section("Parameters", blocks)


def _parameters(calibration: Calibration) -> Table:
    sensors = [f"sensor {sensor + 1}" for sensor in range(calibration.errors.sensor_count)]
    return Table(["parameter", *sensors], parameter_rows(calibration), _MODEL)


def _effects(calibration: Calibration) -> list[Block]:
    blocks: list[Block] = []
    if calibration.effects:
        blocks.append(Table(list(NUMBERS_HEADER), effect_number_rows(calibration), _EFFECTS))
    if rows := effect_size_rows(calibration):
        blocks.append(Table(effect_size_header(), rows, _SIZES))
    return blocks


def _matrices(calibration: Calibration) -> Table:
    rows = []
    for sensor, matrix in enumerate(inv(calibration.errors.matrix)):
        for axis, name in enumerate("xyz"):
            bias = fixed(to_nanotesla(float(calibration.errors.bias_T[sensor, axis])), 3)
            rows.append([f"{sensor + 1} {name}", bias, *(fixed(float(value), 9) for value in matrix[axis])])
    header = ["sensor, axis", "o (nT)", "C, column x", "C, column y", "C, column z"]
    return Table(header, rows, "Bias o and matrix C of each sensor: the inverse of the calibration file's matrix.")


def _weights(calibration: Calibration) -> Table:
    names = [f"b{sensor + 1}{axis}" for sensor in range(calibration.errors.sensor_count) for axis in "xyz"]
    weights = zip(names, calibration.array.operator.T, strict=True)
    rows = [[name, *(_weight(float(value)) for value in row)] for name, row in weights]
    return Table(["from", *OUTPUT_NAMES], rows, _WEIGHTS)


def _weight(value: float) -> str:
    return "" if abs(value) < 1e-12 else fixed(value, 6).rstrip("0").rstrip(".")
