"""`tam demo`: the whole chain, and how it is judged."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from forked_children import ForkedChildren

from tam_calibration.cli.main import main
from tam_calibration.model.exceptions import Refused
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_validation import demo_command as demo


def test_demo_reaches_the_noise_floor(fork_server, ros_domain, tmp_path, monkeypatch, undrawn):
    """A shorter run over DDS ends with exit code 0, a page and a calibration."""
    scenario = replace(read_scenario("tumble_100_hz"), sample_count=700)
    monkeypatch.setattr("tam_validation.demo_command.read_scenario", lambda name: scenario)
    monkeypatch.setattr("tam_validation.demo_command.PLAY_RATE", 4.0)
    monkeypatch.setattr("tam_validation.demo_command.CHECK_SAMPLES", 300)
    monkeypatch.setattr("tam_validation.demo_command.Children", ForkedChildren)
    output = tmp_path / "output"
    result = CliRunner().invoke(main, ["demo", "--output", str(output)])
    assert result.exit_code == 0, result.output
    assert "1000 of 1000 samples synchronised" in " ".join(result.output.split())
    assert (output / "calibration.html").read_text().startswith("<!")
    assert (output / "calibration.yaml").exists()


@pytest.fixture(scope="module")
def run():
    """Return a simulated run."""
    return simulate(replace(read_scenario("tumble_100_hz"), sample_count=300))


def test_judge_accepts_the_true_correction_only(run):
    """What the true errors leave passes; the raw readings and a stream with gaps are refused with their figures."""
    restored = run.errors.restore(run.recording.readings_T).reshape(300, -1) @ run.scenario.array.operator.T
    demo.require_success(run, restored)
    with pytest.raises(Refused, match="times the noise floor"):
        demo.require_success(run, demo.raw_outputs(run))
    with pytest.raises(Refused, match="299 of 300 samples"):
        demo.require_success(run, restored[1:])


def test_error_of_the_truth_is_zero(run):
    """The figures are errors against the simulated truth."""
    truth = np.hstack([run.center_field_T, run.gradient_T_per_m[:, *np.triu_indices(3)]])
    assert np.allclose(demo.errors_of(run, truth), 0)
