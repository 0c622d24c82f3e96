"""A plan as tables for people in a terminal, and as JSON for programs."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tam_calibration.fit.coverage import ENOUGH_STANDARD_ERROR, describe
from tam_calibration.fit.plan import Plan
from tam_calibration.fit.reach import Reach
from tam_calibration.fit.start import Start
from tam_calibration.report.formatting import number, sentence
from tam_calibration.sensor_errors import PARAMETER_NAMES
from tam_calibration.units import FloatArray, to_degrees, to_nanotesla

_GROUPS = (
    ("scale factor", "", 1.0),
    ("non-orthogonality", "deg", to_degrees(1.0)),
    ("bias", "nT", to_nanotesla(1.0)),
    ("misalignment", "deg", to_degrees(1.0)),
)
"""Name, unit and factor from SI of each three parameters of a sensor."""

_HOW_TO_TURN = (
    "From level and facing magnetic north: yaw to the left, then pitch the nose down, then roll the right side down. "
    "The first pose helps most. Any other attitude in which the field points the same way serves as well."
)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A plan and what it was made from.

    Parameters
    ----------
    plan : Plan
        The chosen attitudes and their promise.
    start : Start
        What was known before.
    reach : Reach
        The attitudes to choose from.
    inclination : float
        Of the field, radians.
    inclination_source : str
        Where that comes from.
    samples_per_pose : int
        Samples at each attitude.
    """

    plan: Plan
    start: Start
    reach: Reach
    inclination: float
    inclination_source: str
    samples_per_pose: int

    @property
    def is_enough(self) -> bool:
        """Whether every standard error will be small against the sensor noise."""
        return bool(self.plan.worst[-1] <= ENOUGH_STANDARD_ERROR)


def print_proposal(console: Console, proposal: Proposal) -> None:
    """Print the poses, the standard errors before and after, and whether they are enough."""
    plan, start = proposal.plan, proposal.start
    if start.note:
        console.print(sentence(start.note))
    console.print(_poses(proposal))
    console.print(_HOW_TO_TURN)
    console.print(_standard_errors(proposal))
    field = f"{number(to_nanotesla(start.model.intensity_T), 6)} nT, {_angle(proposal.inclination)}° down"
    console.print(f"Field: {field} ({proposal.inclination_source}).")
    verdict = "enough" if proposal.is_enough else "not yet enough: plan more poses or samples, or allow larger angles"
    worst = f"{_size(start.worst)} before, {_size(plan.worst[-1])} after all poses"
    limit = number(ENOUGH_STANDARD_ERROR, 1)
    console.print(f"Worst standard error: {worst} (× the sensor noise, at most {limit} wanted): {verdict}.")


def _poses(proposal: Proposal) -> Table:
    plan, reach = proposal.plan, proposal.reach
    table = Table(title=f"Poses to record, {proposal.samples_per_pose} samples each")
    for name in ("pose", "yaw (°)", "pitch (°)", "roll (°)"):
        table.add_column(name, justify="right")
    table.add_column("field points")
    table.add_column("worst standard error then (× noise)", justify="right")
    for order, (pose, worst) in enumerate(zip(plan.poses, plan.worst, strict=True), start=1):
        angles = (_angle(angle) for angle in reach.angles[pose])
        table.add_row(str(order), *angles, describe(reach.directions[pose]), _size(worst))
    return table


def _standard_errors(proposal: Proposal) -> Table:
    table = Table("worst of", title="Standard errors")
    table.add_column("before", justify="right")
    table.add_column("after", justify="right")
    for index, (name, unit, factor) in enumerate(_GROUPS):
        columns = (_worst(errors, index, factor) for errors in _before_and_after(proposal))
        table.add_row(f"{name} ({unit})".replace(" ()", "").replace("deg", "°"), *columns)
    return table


def _before_and_after(proposal: Proposal) -> tuple[FloatArray | None, FloatArray]:
    return proposal.start.standard_errors, proposal.plan.standard_errors


def _worst(standard_errors: FloatArray | None, group: int, factor: float) -> str:
    if standard_errors is None:
        return "open"
    part = standard_errors[:, 3 * group : 3 * group + 3]
    sensor, axis = np.unravel_index(int(np.argmax(part)), part.shape)
    if part[sensor, axis] == 0:
        return "fixed"
    name = PARAMETER_NAMES[3 * group + int(axis)].rsplit(" ", 1)[1]
    return f"{number(factor * float(part[sensor, axis]))} ({name} of sensor {sensor + 1})"


def _degrees(radians: FloatArray) -> list[float]:
    degrees: list[float] = np.round(to_degrees(radians), 6).tolist()
    return degrees


def _angle(radians: float) -> str:
    return f"{round(to_degrees(float(radians)), 1) + 0.0:g}".replace("-", "−")


def _size(worst: float) -> str:
    return number(float(worst)) if np.isfinite(worst) else "open"


def proposal_to_mapping(proposal: Proposal) -> dict[str, Any]:
    """Return the content of the JSON; what is open is null."""
    plan, start, reach = proposal.plan, proposal.start, proposal.reach
    before, after = (None if errors is None else _sensors(errors) for errors in _before_and_after(proposal))
    poses = [
        dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), _degrees(reach.angles[pose]), strict=True))
        | {"field_direction": reach.directions[pose].tolist(), "worst_standard_error_in_noise": float(worst)}
        for pose, worst in zip(plan.poses, plan.worst, strict=True)
    ]
    return {
        "field": {
            "intensity_nT": to_nanotesla(start.model.intensity_T),
            "inclination_deg": to_degrees(proposal.inclination),
            "inclination_source": proposal.inclination_source,
        },
        "note": start.note,
        "samples_per_pose": proposal.samples_per_pose,
        "poses": poses,
        "worst_standard_error_in_noise": {"before": start.worst, "after": float(plan.worst[-1])},
        "enough": proposal.is_enough,
        "standard_errors_before": before,
        "standard_errors_after": after,
    }


def _sensors(standard_errors: FloatArray) -> list[dict[str, Any]]:
    keys = [f"{name.replace('-', '_').replace(' ', '_')}_{unit}".rstrip("_") for name, unit, _ in _GROUPS]
    blocks = []
    for sensor, twelve in enumerate(standard_errors, start=1):
        parts = zip(keys, twelve.reshape(4, 3), (factor for _, _, factor in _GROUPS), strict=True)
        blocks.append({"sensor": sensor} | {key: (factor * part).tolist() for key, part, factor in parts})
    return blocks
