"""Whether one source explains amplitudes: noise, the calibration and places do not count as misfit, all else does."""

import numpy as np
import pytest

from tam_calibration.localization import amplitude_fit
from tam_calibration.localization.amplitude_fit import Amplitudes, locate_amplitudes, require_one_source
from tam_calibration.localization.solutions import Status
from tam_calibration.localization.source_fit import PLACE_ERROR_M, SOURCES
from tam_calibration.model.array import Array, tensors_of
from tam_calibration.model.exceptions import Refused
from tam_calibration.sources.dipole import Dipole

ARRAY = Array.cross(0.5, vector_noise_T=1e-9)
COIL = Dipole(np.array([2.0, -1.2, 0.7]), np.array([30.0, -20.0, 25.0]))
OTHER = Dipole(np.array([-1.5, 2.0, 1.0]), np.array([10.0, 15.0, -20.0]))
NOISE_T = 5e-11
STILL = np.eye(3)[None]


def wire_T(points):
    """Return the field of 10 A along y, two metres below and one ahead."""
    across = points - [1.0, 0, -2.0]
    across[..., 1] = 0
    return 2e-6 * np.cross([0.0, 1.0, 0.0], across) / np.sum(across**2, axis=-1, keepdims=True)


def heard(field_of, seed=1, places_m=0.0, errors=0):
    """Return the amplitudes of one pose: fields at the sensors with noise, errors of their places and of gains."""
    generator = np.random.default_rng(seed)
    fields = field_of(ARRAY.positions_m + places_m * generator.normal(size=(4, 3)))
    values = fields.ravel() + NOISE_T * generator.normal(size=12)
    by_errors = 1e-4 * np.diag(values)[:, :errors]
    values = values + by_errors @ generator.normal(size=errors)
    tensors = tensors_of((ARRAY.operator @ values)[None])
    return Amplitudes(
        values,
        NOISE_T**2 * np.eye(12),
        ARRAY.positions_m,
        np.eye(12),
        by_errors,
        np.eye(12).reshape(4, 3, 12),
        np.broadcast_to(tensors, (4, 3, 3)),
        ARRAY.operator[:8],
    )


def fits_of(part):
    """Return the fit of each structural index."""
    return {index: locate_amplitudes([part], STILL, index)[1] for index in SOURCES}


@pytest.mark.parametrize("errors", [0, 12])
def test_pulls_of_a_coil_have_their_size(errors):
    """Of noise alone, and where errors of the gains are twenty times as large: six degrees of freedom are left.

    One in twenty has wider errors, as what is left may be that of the places.
    """
    pulls, sizes = [], []
    for seed in range(40):
        fit = locate_amplitudes([heard(COIL.field_T, seed, errors=errors)], STILL, 3.0)[1]
        assert fit.is_explaining and fit.degrees_of_freedom == 6
        if fit.place_error_m:
            continue
        off = fit.solution.unknowns[0, :3] - COIL.position_m
        pulls.append(off / np.sqrt(np.diag(fit.solution.covariance[0])[:3]))
        sizes.append(fit.reduced_chi_square)
    assert len(pulls) >= 35
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1, abs=0.2)
    assert np.mean(sizes) == pytest.approx(1, abs=0.25)


def test_sensors_beside_their_places_widen_the_errors():
    """A millimetre shows: it is then in the standard errors, which hold the source."""
    for seed in range(5):
        fit = locate_amplitudes([heard(COIL.field_T, seed, places_m=PLACE_ERROR_M)], STILL, 3.0)[1]
        errors = np.sqrt(np.diag(fit.solution.covariance[0])[:3])
        assert fit.is_explaining and fit.place_error_m == PLACE_ERROR_M and errors.max() > 1e-3
        assert (np.abs(fit.solution.unknowns[0, :3] - COIL.position_m) < 4.5 * errors).all()


def test_a_coil_is_no_line_and_is_named():
    """Taken for a line of current it is refused, and told to be a dipole."""
    fits = fits_of(heard(COIL.field_T))
    require_one_source(fits, 3.0)
    with pytest.raises(Refused, match=r"not those of one line of current.*They are those of a dipole"):
        require_one_source(fits, 1.0)


def test_a_wire_is_no_dipole_and_is_named():
    """Ten amperes two metres away."""
    fits = fits_of(heard(wire_T))
    require_one_source(fits, 1.0)
    with pytest.raises(Refused, match=r"not those of one dipole.*line of current"):
        require_one_source(fits, 3.0)


def test_two_coils_are_refused():
    """Of one phase; nothing else explains them either."""
    with pytest.raises(Refused, match="There are two sources, or one that is large for its distance"):
        require_one_source(fits_of(heard(lambda points: COIL.field_T(points) + OTHER.field_T(points))), 3.0)


def test_a_dipole_that_a_line_explains_as_well_is_refused():
    """At right angles to the line of sight and far away, at the noise: it may be a wire at a third of the distance."""
    far = Dipole(np.array([6.0, 0.0, 0.0]), np.array([0.0, 0.0, 20.0]))
    with pytest.raises(Refused, match="explains the amplitudes as well as a dipole"):
        require_one_source(fits_of(heard(far.field_T)), 3.0)


def test_poses_of_one_source_are_one_and_of_two_are_not(monkeypatch):
    """The second pose hears another coil: each by itself is one, together they are not; signs do not matter."""
    turns = np.array([np.eye(3), [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]])

    def parts(second, sign):
        own = [heard(COIL.field_T)]
        return [*own, heard(lambda points: sign * second.field_T(points @ turns[1].T) @ turns[1], 2)]

    for sign in (1, -1):
        solutions, together = locate_amplitudes(parts(COIL, sign), turns, 3.0)
        assert together.is_explaining and together.degrees_of_freedom == 18 and solutions.is_located.all()
        assert np.allclose(together.solution.unknowns[0, :3], COIL.position_m, atol=0.01)
    solutions, together = locate_amplitudes(parts(OTHER, 1), turns, 3.0)
    assert solutions.is_located.all() and not together.is_explaining
    monkeypatch.setattr(amplitude_fit, "_MOST_POSES", 1)
    assert locate_amplitudes(parts(COIL, 1), turns, 3.0)[1].degrees_of_freedom == 6


def test_noise_shows_nowhere_to_begin():
    """The pose has a reason, and there is no fit."""
    solutions, together = locate_amplitudes([heard(lambda points: np.zeros_like(points))], STILL, 3.0)
    assert together is None and solutions.status.tolist() == [Status.NO_FIELD]
