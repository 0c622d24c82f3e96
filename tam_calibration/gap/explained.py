"""A doubt about the residual of a calibration, with the cause that a diagnosis finds for it."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.consistency import LOOK_FOR_CAUSE, SOMETHING_MAGNETIC
from tam_calibration.gap.diagnose import diagnose
from tam_calibration.gap.result import Gap
from tam_calibration.gap.search import Progress
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused, sensors_in_words
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import to_nanotesla


def explained(
    calibration: Calibration,
    samples: SampleSource,
    array: Array,
    *,
    progress: Progress | None = None,
    accept: Collection[str] = (),
) -> Calibration:
    """Return a calibration whose doubt about its residual names the cause, as far as a diagnosis finds one.

    Parameters
    ----------
    calibration : Calibration
        As ``is_unexplained`` finds it.
    samples : SampleSource
        That it was made from; of more than 10 000 every n-th one is looked at, which takes some seconds.
    array, progress, accept
        As of ``diagnose``.
    """
    with suppress(InputError, Refused):
        # The user did not ask for this diagnosis: so many samples take some seconds.
        gap = diagnose(samples.thinned(10_000), array, progress=progress, accept=accept)
        kept = [one for one in calibration.warnings if not gap.causes or SOMETHING_MAGNETIC not in one]
        found = _in_words(gap)
        return replace(calibration, warnings=tuple(one.replace(f": {LOOK_FOR_CAUSE}", found) for one in kept))
    return calibration


def _in_words(gap: Gap) -> str:
    """Return what explains a residual and what to do, as the end of the sentence on it."""
    if gap.verdict == "no_gap":
        levels_nT = [to_nanotesla(one.white_T) for one in gap.noise if one.sensor]
        size = f" of {min(levels_nT):.3g} to {max(levels_nT):.3g} nT" if levels_nT else ""
        return f"; white noise{size} explains it: state that noise in the array file"
    names = list(dict.fromkeys(cause.fitted.effect for cause in gap.causes))
    if not names:
        return "; no known effect explains it: see where and when it is, with tam diagnose --report"
    causes = " and ".join(name.replace("_", " ") for name in names)
    sensors = sorted({sensor for cause in gap.causes for sensor in cause.sensors}, key=str)
    where = f" in {sensors_in_words(sensors, len(gap.residue.floor_T) // 3)}"
    verb = f"explain{'s' if len(names) == 1 else ''}{'' if gap.verdict == 'explained' else ' part of'}"
    return f"; {causes}{where} {verb} it: fit that too, with --effects {','.join(names)}"
