"""Fixtures of a comparison with a known truth, made by hand: what is told of it is tested without the judge."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.comparison.mend import Mend, NoiseTerm
from tam_calibration.comparison.result import (
    Closing,
    Comparison,
    EffectDifference,
    Mistake,
    NoiseDifference,
    OtherParameters,
    SourceError,
    Step,
)
from tam_calibration.comparison.side import Figure, ReadingFigure, Side
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

MISTAKE = Mistake(
    "gauss_for_tesla",
    "The simulation's field is 10⁴ times the Earth's: gauss was written where the topic has tesla",
    "all sensors",
    "Divide the readings by 10 000",
)


def axis_noise(sensor, axis, level_T, colour="white"):
    """Return noise of a level: white, or with a band at 10 to 14 Hz."""
    frequency = np.linspace(0, 50, 129)
    density = np.full(129, 2 * level_T**2 / 100)
    if colour == "band":
        density = density * (1 + 30 * np.exp(-(((frequency - 12) / 2) ** 2)))
    band = (10.0, 14.0) if colour == "band" else None
    size = 0.5 * level_T if band else 0.0
    return AxisNoise(
        sensor, axis, level_T, 0.02 * level_T, colour, level_T, np.nan, np.nan, band, size, np.nan,
        frequency, density, 0.8 * density, 1.25 * density,
    )  # fmt: skip


def noise_of(others=None):
    """Return the noise of four sensors and the scalar: 1 nT, but for those that are given by (sensor, axis)."""
    usual = {(sensor, axis): axis_noise(sensor, axis, 1e-9) for sensor in range(1, 5) for axis in "xyz"}
    return tuple((usual | {(0, ""): axis_noise(0, "", 1e-10)} | (others or {})).values())


@pytest.fixture(scope="session")
def comparison(gap, recording, cross):
    """Return a comparison: sensor 2 drifts with temperature in the recording only, and has noise in a band at y."""
    from tam_calibration.fit import calibrate

    calibration = calibrate(recording, cross)
    quiet = replace(gap, verdict="no_gap", causes=(), residue=replace(gap.residue, before=gap.residue.after))
    sides = [
        Side(recording, cross, replace(each, noise=noise), calibration, None)
        for each, noise in ((quiet, noise_of()), (gap, noise_of({(2, "y"): axis_noise(2, "y", 2e-9, "band")})))
    ]
    (cause,) = gap.causes
    places = {"sensors": (2,), "axes": ("x", "y", "z"), "probability": 0.98, "size": 1.9}
    drift = EffectDifference(
        "temperature_drift", **places, is_shown_by_other_run=True, fitted=cause.fitted, units=cause.units
    )
    offsets = tuple(replace(part, values={"offset": 2 * part.values["offset"]}) for part in cause.fitted.contributions)
    slower = replace(drift, fitted=replace(cause.fitted, contributions=offsets))
    figures = (
        Figure(
            ReadingFigure("stamps", "rate", "Hz", 100.0, 0.01),
            ReadingFigure("stamps", "rate", "Hz", 50.0, 0.02),
        ),
        Figure(
            ReadingFigure("errors of the sensors", "sensor 2 x bias", "T", 3e-9, 1e-10),
            ReadingFigure("errors of the sensors", "sensor 2 x bias", "T", np.nan),
        ),
    )
    closing = Closing(
        1.9, 0.2, 1.9e-9, 2e-10, 5.4e-9, np.nan, 1e-9, 0.989, (0.97, 1.0),
        (Step("temperature_drift of sensor 2", 0.6), Step("noise of sensor 2 y", 0.2)),
        SourceError(0.10, (0.08, 0.12)), SourceError(0.35, (0.30, 0.41)), SourceError(0.33, (0.28, 0.38)),
        "A tenth of the drift of sensor 2 stays",
    )  # fmt: skip
    jump = FittedEffect("bias_jump", {"time_s": 1.7e9}, (Contribution(1, 0, "offset", {"offset": 2e-8}),))
    terms = (NoiseTerm(2, "y", 1e-9, 0.0, band_hz=(10.0, 14.0), band_T=1e-9), NoiseTerm(0, "", 1e-10, 0.0))
    return Comparison(
        "differs",
        "The simulation lacks temperature_drift of sensor 2.",
        figures=figures,
        missing=(drift,),
        surplus=(EffectDifference("unknown", ("scalar",), (), 0.9, 0.5, is_shown_by_other_run=False),),
        other_parameters=(OtherParameters(drift, slower),),
        noise=tuple(
            NoiseDifference(*each, each[1].colour == "band") for each in zip(*(s.gap.noise for s in sides), strict=True)
        ),
        closing=closing,
        mend=Mend((jump,), (), terms, calibration, 100.0),
        simulation=sides[0],
        recording=sides[1],
        remarks=("The recording: its noise is twice what its array states.",),
    )


@pytest.fixture(scope="session")
def mistaken():
    """Return a comparison that ended at a gross mistake of the simulator."""
    return Comparison("differs", "The simulation cannot be right: its unit is not tesla.", (MISTAKE,))
