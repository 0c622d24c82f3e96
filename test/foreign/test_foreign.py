"""Recordings of strangers are calibrated right by at most two commands, without renaming anything."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from foreign.bags import BAGS
from foreign.broken import BROKEN
from foreign.logs import LOGS
from foreign.texts import TEXTS
from foreign.truth import ARDUPILOT, AUTOPILOT, CROSS, SINGLE

from tam_calibration import Array, Recording, calibrate
from tam_calibration.cli.main import main
from tam_calibration.results import read_calibration

FOREIGN = [*BAGS, *TEXTS, *LOGS, *BROKEN]

LARGEST_MISFIT = 0.5
"""Largest rms error of the corrected field over the noise; a sound fit leaves 0.2 for an array, 0.3 for one sensor."""


def test_there_are_24():
    """Eight bags, eight texts, four logs and four broken ones; one of them may be refused."""
    assert [len(kind) for kind in (BAGS, TEXTS, LOGS, BROKEN)] == [8, 8, 4, 4]
    assert sum(bool(foreign.sentence) for foreign in FOREIGN) == 1
    assert all(len(foreign.commands) <= 2 for foreign in FOREIGN)


@pytest.mark.parametrize("foreign", FOREIGN, ids=lambda foreign: foreign.file)
def test_it_is_calibrated_right(foreign, tmp_path, monkeypatch):
    """The commands succeed, and the calibration brings the readings of each sensor back to the true field."""
    monkeypatch.chdir(tmp_path)
    foreign.write(tmp_path)
    for command in foreign.commands:
        done = CliRunner().invoke(main, command.format(file=foreign.file).split())
        if foreign.sentence and done.exit_code in (1, 2):
            (sentence,) = [line for line in done.stderr.splitlines() if line.startswith("tam: ")]
            assert any(word in sentence for word in foreign.sentence)
            return
        assert done.exit_code == 0, done.output
    misfit_T = foreign.truth.misfit_T(read_calibration("cal.yaml"))
    assert (misfit_T < LARGEST_MISFIT * foreign.truth.noise_T).all(), 1e9 * misfit_T


def test_wrap_around_is_named(tmp_path, monkeypatch):
    """Without ``--unwrap`` the recording of a counter that overflows is refused by a sentence that names it."""
    monkeypatch.chdir(tmp_path)
    BROKEN[3].write(tmp_path)
    done = CliRunner().invoke(main, ["calibrate", BROKEN[3].file, "--array", "array.yaml", "-o", "cal.yaml"])
    assert done.exit_code in (1, 2)
    assert "--unwrap" in done.stderr


@pytest.mark.parametrize("truth", [CROSS, ARDUPILOT, AUTOPILOT, SINGLE])
def test_the_truth_can_be_found(truth):
    """The samples themselves, at common times, are calibrated to far less than the limit; a wrong unit is not."""
    noise_T = np.full(truth.sensor_count, truth.noise_T)
    array = Array(Array.cross(0.5).positions_m[: truth.sensor_count], noise_T, 1e-10 if truth.has_scalar else None)
    at_once = replace(truth, stagger_s=0)
    recording = Recording(at_once.time_s, at_once.readings_T, at_once.scalar_T if truth.has_scalar else None)
    errors = calibrate(recording, array).errors
    assert (at_once.misfit_T(SimpleNamespace(errors=errors)) < 0.7 * LARGEST_MISFIT * truth.noise_T).all()
    wrong = SimpleNamespace(matrix=10 * errors.matrix, bias_T=10 * errors.bias_T)
    assert (at_once.misfit_T(SimpleNamespace(errors=wrong)) > LARGEST_MISFIT * truth.noise_T).all()
