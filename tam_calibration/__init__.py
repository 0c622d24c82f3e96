"""Calibration of cross arrays of tri-axial magnetometers, on line over ROS 2 and offline.

From Python: read a recording and its array, ``calibrate``, ``diagnose`` or ``compare`` it, ``correct``, ``locate``.
``calibrate_with_effects`` fits effects too; ``make_plan``, ``export`` and ``run_batch`` do what the commands do.
Names load when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tam_calibration.comparison import compare as compare
    from tam_calibration.correction.calibration import Calibration as Calibration
    from tam_calibration.correction.streaming import correct as correct
    from tam_calibration.fit import calibrate as calibrate
    from tam_calibration.fit.plan import make_plan as make_plan
    from tam_calibration.fleet.batch import run_batch as run_batch
    from tam_calibration.gap import diagnose as diagnose
    from tam_calibration.gap.calibration_with_effects import calibrate_with_effects as calibrate_with_effects
    from tam_calibration.gap.delays import estimate_delays as estimate_delays
    from tam_calibration.localization.locate import locate as locate
    from tam_calibration.model.array import Array as Array
    from tam_calibration.model.exceptions import InputError as InputError
    from tam_calibration.model.exceptions import Refused as Refused
    from tam_calibration.model.geomagnetic_field import site_field_T as site_field_T
    from tam_calibration.model.recording import Recording as Recording
    from tam_calibration.recordings import read_array as read_array
    from tam_calibration.recordings import read_recording as read_recording
    from tam_calibration.recordings.inspection import inspect as inspect
    from tam_calibration.results import read_calibration as read_calibration
    from tam_calibration.results import write_calibration as write_calibration
    from tam_calibration.results.export import export as export
    from tam_calibration.results.scenario import read_scenario as read_scenario
    from tam_calibration.simulation import simulate as simulate

_HOMES = {
    "Array": "model.array",
    "Calibration": "correction.calibration",
    "InputError": "model.exceptions",
    "Recording": "model.recording",
    "Refused": "model.exceptions",
    "calibrate": "fit",
    "calibrate_with_effects": "gap.calibration_with_effects",
    "compare": "comparison",
    "correct": "correction.streaming",
    "diagnose": "gap",
    "estimate_delays": "gap.delays",
    "export": "results.export",
    "inspect": "recordings.inspection",
    "locate": "localization.locate",
    "make_plan": "fit.plan",
    "read_array": "recordings",
    "read_calibration": "results",
    "read_recording": "recordings",
    "read_scenario": "results.scenario",
    "run_batch": "fleet.batch",
    "simulate": "simulation",
    "site_field_T": "model.geomagnetic_field",
    "write_calibration": "results",
}
"""The module of each public name."""

__all__ = list(_HOMES)

try:
    __version__ = version("tam_calibration")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "unknown"


def __getattr__(name: str) -> object:
    """Return a public name from its module (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__, "__version__"]
