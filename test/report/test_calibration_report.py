import errno

import numpy as np
import pytest

from tam_calibration.correction.parts import Provenance
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.report import calibration_report
from tam_calibration.report.blocks import Text
from tam_calibration.report.calibration_report import write_calibration_report
from tam_calibration.report.calibration_rows import summary_blocks


@pytest.fixture
def write(tmp_path, read_page):
    """Return a function that writes a report and reads it back."""

    def write(calibration, recording):
        write_calibration_report(tmp_path / "report.html", calibration, recording)
        assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
        return read_page(tmp_path / "report.html")

    return write


def test_sections_stand_in_order(make, write):
    """The verdict comes first, the provenance last; all is drawn."""
    page = write(*make())
    assert page.headings == [
        "Verdict",
        "Residuals over time",
        "Coverage of the sphere",
        "Distribution of the residuals",
        "Parameters",
        "Quality",
        "Provenance",
    ]
    assert len(page.references) == 7


def test_figures_of_the_calibration_are_on_the_page(make, write, undrawn):
    """Residuals, parameters with standard errors, χ² and provenance can be read off."""
    covariance = np.zeros((48, 48))
    covariance[6, 6] = (0.12e-9) ** 2
    calibration, recording = make(covariance=covariance)
    page = write(calibration, recording)
    bias_nT = f"{1e9 * calibration.errors.bias_T[0, 0]:.2f}".replace("-", "−")
    assert f"{bias_nT} ± 0.12" in page.text
    assert f"{1e9 * calibration.before.tensor_T_per_m[0]:.0f}" in page.text
    assert f"{1e9 * calibration.in_sample.tensor_rmse_T_per_m:.2f}" in page.text
    assert "1.01 between the sensors and 0.980 against the reference intensity" in page.text
    assert all(words in page.text for words in ("tumble_4.csv", "ab" * 32, "123 456 bytes", "maximum_likelihood"))
    assert all(statement in page.text for statement in calibration.statements)


def test_channels_whose_residuals_last_are_told_apart(make, write, undrawn):
    """Each factor beside the reduced χ², with what it is of."""
    slow = {"common_mode": 1.0, "slow_differential": 3.0, "slow_common_mode": 8e4}
    text = write(*make(reduced_chi_square=slow)).text
    assert "3.00 between the sensors in sums over many samples" in text
    assert "80000 against the reference intensity in sums over many samples" in text.replace("\u202f", "").replace(
        " 000", "000"
    )


def test_names_are_escaped(make, write, undrawn):
    """A file name cannot inject markup."""
    page = write(*make(source=Provenance("<script>alert(1)</script>&amp;.csv", 1, "00"), method="<b>"))
    assert page.text.count("<script>alert(1)</script>&amp;.csv") >= 2
    assert "<b>" in page.text


def test_one_sensor_has_no_tensor(make, write, one_sensor, undrawn):
    """Where there is no gradient the page says so instead of drawing NaN."""
    page = write(*make(one_sensor))
    assert "does not determine a gradient tensor" in page.text
    assert len(page.references) == 4
    assert "nT/m" not in page.text
    assert "nan" not in page.text.lower().split()


def test_one_sensor_has_no_misalignment(make, write, one_sensor, undrawn):
    """Its axes are those of the array: neither page nor words state an angle that is zero by convention."""
    calibration, recording = make(one_sensor, covariance=np.diag([1e-24] * 9 + [0.0] * 3))
    words = " ".join(block.text for block in summary_blocks(calibration) if isinstance(block, Text))
    assert "misalignment x" not in write(calibration, recording).text
    assert "bias" in words and "misalignment" not in words


def test_several_sensors_in_one_place_have_no_tensor(make, write, undrawn):
    """A geometry without gradient still has a centre."""
    page = write(*make(Array(np.zeros((3, 3)), np.full(3, 1e-9), 1e-10)))
    assert "|B|, centre (nT)" in page.text
    assert len(page.references) == 4


def test_without_scalar_and_held_out_samples(make, write, undrawn):
    """What is missing is said."""
    page = write(*make(scalar=False, held_out=None, reduced_chi_square={}, source=None))
    assert "|B| − the fitted constant intensity" in page.text
    assert "No samples were held out" in page.text
    assert "no reduced χ²" in page.text
    assert "not from a file" in page.text


def test_scalar_reference_with_gaps(make, write, undrawn):
    """Samples without a reference are left out of the |B| residual."""
    calibration, recording = make(samples=5000)
    recording.scalar_T[100:2500] = np.nan
    assert "scalar reference" in write(calibration, recording).text


def test_page_of_a_long_recording_stays_small(make, write, one_sensor, tmp_path):
    """The size of the page does not grow with the recording, which is drawn for one sensor too; thinning is said."""
    page = write(*make(one_sensor, samples=100_000))
    assert (tmp_path / "report.html").stat().st_size < 3_000_000
    assert "each stroke spans the smallest to the largest of 100 consecutive samples" in page.text


def test_failure_leaves_the_old_page(make, tmp_path, monkeypatch, undrawn):
    """Nothing is written, and nothing stored is lost, when a section fails."""
    path = tmp_path / "report.html"
    path.write_text("old")

    def fail(calibration):
        raise InputError("no")

    monkeypatch.setattr(calibration_report, "quality_blocks", fail)
    with pytest.raises(InputError):
        write_calibration_report(path, *make())
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_unwritable_place_is_an_input_error(make, tmp_path, undrawn):
    """A folder that does not exist is said, and nothing is left behind."""
    with pytest.raises(InputError, match="missing"):
        write_calibration_report(tmp_path / "missing" / "report.html", *make())
    assert list(tmp_path.iterdir()) == []


def test_recording_of_another_array_is_refused(make, tmp_path, one_sensor):
    """A recording that is not the calibration's is an input error."""
    with pytest.raises(InputError, match="4 sensors"):
        write_calibration_report(tmp_path / "report.html", make()[0], make(one_sensor)[1])
    assert list(tmp_path.iterdir()) == []


def test_full_disk_leaves_the_old_page(make, tmp_path, monkeypatch, undrawn):
    """When writing breaks off half way the older page stays, and no part of the new one."""
    path = tmp_path / "report.html"
    path.write_bytes(b"old")

    def break_off(self, text, encoding):
        self.write_bytes(text[:1000].encode(encoding))
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(type(path), "write_text", break_off)
    with pytest.raises(InputError, match=r"report.html cannot be written: No space left on device"):
        write_calibration_report(path, *make())
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
