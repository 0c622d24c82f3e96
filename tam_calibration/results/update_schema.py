"""How a calibration file states what it took from the calibration before it."""

import dataclasses
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.correction.calibration import Moved, Update
from tam_calibration.files import quantities
from tam_calibration.files.quantities import part_of, part_to_mapping, value_in_si, value_to_write
from tam_calibration.files.schema import Bounds, Document
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

_Part = Annotated[float, Bounds(least=0, most=1, may_be_nan=True)]
_StandardError = Annotated[float, Bounds(least=0, most=1e12)]
"""SI, of an error of a sensor: a larger one means a damaged file, as in the calibration itself."""

_Kind = Literal["scale factor", "non-orthogonality", "bias", "misalignment"]

_UNIT_OF = {"scale factor": "", "non-orthogonality": "_deg", "bias": "_nT", "misalignment": "_deg"}


class _ChangeFile(Document):
    kind: _Kind | Literal["several errors", "biases", "scalar reading, or the scale factors"]
    sensor: int


class _MovedFile(Document):
    kind: _Kind
    sensor: int
    change: quantities.Vector | None = None
    change_nT: quantities.Vector | None = None
    change_deg: quantities.Vector | None = None
    standard_error: quantities.Vector | None = None
    standard_error_nT: quantities.Vector | None = None
    standard_error_deg: quantities.Vector | None = None
    probability: _Part
    rivals: list[_ChangeFile] = dataclasses.field(default_factory=list)
    since_s: quantities.Seconds | None = None
    together: _ChangeFile | None = None

    def to_moved(self) -> Moved:
        """Return the change in SI."""
        rivals = tuple(map(dataclasses.astuple, self.rivals))
        change, error = self._in_si("change"), self._in_si("standard_error")
        together = dataclasses.astuple(self.together) if self.together else None
        return Moved(self.kind, self.sensor, change, error, self.probability, rivals, self.since_s, together)

    def _in_si(self, name: str) -> FloatArray:
        key = name + _UNIT_OF[self.kind]
        if getattr(self, key) is None:
            raise InputError(f"the file is damaged: a {self.kind} that moved has no {key}")
        return np.asarray(value_in_si(key, getattr(self, key)))


class UpdateFile(Document):
    """The keys of ``update``, in the order of `Update`.

    Tables have a row of twelve numbers for each sensor, SI, as ``covariance_SI`` has.
    """

    prior: str
    change_rates: quantities.RatesFile | None
    elapsed_s: Annotated[float, Bounds(least=0)] | None
    warming_K: quantities.Finite | None
    prior_standard_errors_SI: list[list[_StandardError]]
    data_share: list[list[_Part]]
    chi_square: Annotated[float, Bounds(least=-1e-6)]
    freedom: int
    probability: _Part
    moved: list[_MovedFile]

    def to_update(self, sensor_count: int) -> Update:
        """Return the update in SI.

        Raises
        ------
        InputError
            When a table is not of so many sensors.
        """
        for name in ("prior_standard_errors_SI", "data_share"):
            if [len(row) for row in getattr(self, name)] != [12] * sensor_count:
                raise InputError(f"the file is damaged: {name} must have {sensor_count} rows of 12 numbers")
        return Update(
            prior=self.prior,
            rates=part_of(self.change_rates),
            elapsed_s=self.elapsed_s,
            warming_K=self.warming_K,
            prior_standard_errors=np.array(self.prior_standard_errors_SI),
            data_share=np.array(self.data_share),
            chi_square=self.chi_square,
            freedom=self.freedom,
            probability=self.probability,
            moved=tuple(each.to_moved() for each in self.moved),
        )


def update_to_mapping(update: Update) -> dict[str, Any]:
    """Return the keys and values of an update in a file."""
    stated = zip(dataclasses.fields(UpdateFile), dataclasses.fields(Update), strict=True)
    mapping = {key.name: value_to_write(key.name, getattr(update, own.name)) for key, own in stated}
    moved = [_moved_to_mapping(each) for each in update.moved]
    return mapping | {"change_rates": part_to_mapping(update.rates), "moved": moved}


def _moved_to_mapping(moved: Moved) -> dict[str, Any]:
    unit = _UNIT_OF[moved.kind]
    return {
        "kind": moved.kind,
        "sensor": moved.sensor,
        f"change{unit}": value_to_write(unit, moved.change),
        f"standard_error{unit}": value_to_write(unit, moved.standard_errors),
        "probability": moved.probability,
        "rivals": [_change_to_mapping(rival) for rival in moved.rivals],
        "since_s": moved.since_s,
        "together": moved.together and _change_to_mapping(moved.together),
    }


def _change_to_mapping(change: tuple[str, int]) -> dict[str, Any]:
    return dict(zip(("kind", "sensor"), change, strict=True))
