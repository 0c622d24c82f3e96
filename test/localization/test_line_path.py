"""The path of a platform from noisy positions, and the errors that it states."""

import numpy as np
import pytest

from tam_calibration.localization.line_path import Basis, path_of, reckoned
from tam_calibration.model.exceptions import InputError

TIME_S = np.arange(600) / 10
TRUE_M = np.column_stack([TIME_S, 0.3 * np.sin(2 * np.pi * TIME_S / 8), 0.2 * np.cos(2 * np.pi * TIME_S / 11) - 5])


def test_a_basis_reproduces_lines():
    """Splines with coefficients on a line are that line."""
    basis = Basis.over(0.0, 10.0, 0.8)
    at = np.linspace(0, 10, 57)
    assert basis.matrix(at) @ (2 * basis.centers + 1) == pytest.approx(2 * at + 1)


@pytest.mark.parametrize("white_m", [0.0, 0.05, 0.4])
def test_a_path_is_smooth_and_its_error_is_stated(white_m):
    """What noise leaves of a swaying path is as large as the path states, without being told the noise."""
    generator = np.random.default_rng(4)
    path = path_of(TIME_S, TRUE_M + white_m * generator.standard_normal(TRUE_M.shape))
    away = path.at(TIME_S) - TRUE_M
    own, roots = path.error(TIME_S[0], TIME_S[-1])
    rows = path.basis.matrix(TIME_S)[:, own]
    stated = np.sqrt(np.mean([np.sum((rows @ root) ** 2, axis=1) for root in roots]))
    assert np.sqrt(np.mean(away**2)) < 1.5 * stated
    assert stated < max(0.7 * white_m, 2e-3)


def test_exact_positions_of_a_fast_sway_are_followed():
    """To a tenth of a millimetre: the field of a strong target changes by its noise in that."""
    true = TRUE_M + 0.05 * np.sin(2 * np.pi * TIME_S / 3)[:, None]
    assert np.abs(path_of(TIME_S, true).at(TIME_S[10:-10]) - true[10:-10]).max() < 1e-4


def test_a_repeated_position_counts_once():
    """Navigation that is slower than the samples repeats its last position, which is true when it comes first."""
    held = TRUE_M[5 * (np.arange(600) // 5)]
    assert np.abs(path_of(TIME_S, held).at(TIME_S[:590]) - TRUE_M[:590]).max() < 0.02


def test_positions_in_millimetres_are_refused():
    """They move at a thousand times the speed."""
    with pytest.raises(InputError, match="the positions move at 1000 m/s: state them in metres"):
        path_of(TIME_S, 1000 * TRUE_M)


def test_a_drift_is_in_the_error_and_grows_slowly():
    """The error at one moment is the drift, that between two close moments far less."""
    path = path_of(TIME_S, TRUE_M, drift_m=0.3)
    own, roots = path.error(10.0, 50.0)
    rows = path.basis.matrix(np.array([20.0, 20.5]))[:, own] @ roots[0]
    assert np.linalg.norm(rows[0]) == pytest.approx(0.3, rel=0.05)
    assert np.linalg.norm(rows[1] - rows[0]) < 0.1


def test_a_reckoned_path_is_straight_and_less_certain_later():
    """A velocity gives a straight path; its error makes places uncertain in proportion to time."""
    path = reckoned(TIME_S, np.array([1.0, 0.5, 0.0]), 0.02)
    assert path.at(TIME_S) == pytest.approx(np.outer(TIME_S, [1.0, 0.5, 0.0]), abs=1e-9)
    own, roots = path.error(0.0, 59.0)
    rows = path.basis.matrix(np.array([50.0]))[:, own] @ roots[0]
    assert np.linalg.norm(rows) == pytest.approx(np.hypot(1.0, 0.2), rel=0.1)


def test_a_platform_at_rest_is_no_line():
    """One position is not enough."""
    with pytest.raises(InputError, match="needs four"):
        path_of(TIME_S, np.tile(TRUE_M[0], (600, 1)))
