import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit.coverage import CELLS, cell_directions, cell_of, describe, measure_coverage
from tam_calibration.fit.turns import LiveCoverage

FIELD_T = 5e-5


def sphere(count, seed=0):
    """Return unit vectors in random directions."""
    direction = np.random.default_rng(seed).standard_normal((count, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def cap(count, pitch_deg, seed=0):
    """Return directions of a field of 62° inclination seen by a vehicle that yaws fully and pitches and rolls a bit."""
    from scipy.spatial.transform import Rotation

    generator = np.random.default_rng(seed)
    tilt = generator.uniform(-pitch_deg, pitch_deg, (count, 2))
    angles = np.column_stack([generator.uniform(0, 360, count), tilt])
    return Rotation.from_euler("ZYX", angles, degrees=True).inv().apply([0.47, 0, -0.883])


def test_cells_have_equal_areas():
    """A uniform sample of the sphere fills all cells alike."""
    counts = np.bincount(cell_of(sphere(400_000)), minlength=CELLS)
    assert_allclose(counts, 2000, atol=5 * np.sqrt(2000))


def test_every_cell_holds_its_own_centre():
    """The centre of each cell falls into that cell."""
    assert (cell_of(cell_directions()) == np.arange(CELLS)).all()


def test_full_sphere_is_enough():
    """A few hundred samples over the sphere are enough, and no worse than the sphere."""
    coverage = measure_coverage(FIELD_T * sphere(400))
    assert coverage.enough
    assert coverage.relative_error == pytest.approx(1.0, abs=0.3)
    assert "enough" in coverage.advice


def test_a_ring_is_not_enough_and_the_missing_pole_is_named():
    """A turn about the vertical alone leaves parameters open, and the advice sends the field up or down."""
    angle = np.linspace(0, 2 * np.pi, 500)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(500)], axis=1)
    coverage = measure_coverage(FIELD_T * ring)
    assert not coverage.enough
    assert np.isinf(coverage.relative_error)
    assert "up" in coverage.missing or "down" in coverage.missing


def test_advice_followed_leads_to_enough():
    """Samples added where the advice points end in enough coverage within ten turns."""
    fields = [FIELD_T * cap(200, 10)]
    for _ in range(10):
        coverage = measure_coverage(np.concatenate(fields))
        if coverage.enough:
            break
        words = coverage.missing.split(" and ")
        axes = {"forward": (0, 1), "backward": (0, -1), "left": (1, 1), "right": (1, -1), "up": (2, 1), "down": (2, -1)}
        target = np.zeros(3)
        for word in words:
            axis, sign = axes[word]
            target[axis] = sign
        spread = target / np.linalg.norm(target) + 0.15 * np.random.default_rng(len(fields)).standard_normal((40, 3))
        fields.append(FIELD_T * spread / np.linalg.norm(spread, axis=1, keepdims=True))
    assert measure_coverage(np.concatenate(fields)).enough


def test_live_coverage_sees_through_a_large_bias():
    """Raw readings about a bias of ten times the field are judged as the fields are."""
    live = LiveCoverage()
    directions = sphere(2000)
    for reading in FIELD_T * directions + np.array([4e-4, -3e-4, 0]):
        live.add(reading)
    expected = measure_coverage(FIELD_T * directions)
    assert live.summary().fraction == pytest.approx(expected.fraction, abs=0.02)


def test_live_coverage_keeps_its_memory_bounded():
    """More samples than its capacity are thinned, not kept, and a reset forgets them."""
    live = LiveCoverage(capacity=100)
    for _ in range(50):
        for reading in FIELD_T * sphere(37):
            live.add(reading)
    assert 50 <= live.summary().counts.sum() < 100
    live.reset()
    assert live.summary().fraction == 0


def test_directions_in_words():
    """Axes are named as the array frame has them: x forward, y left, z up."""
    assert describe(np.array([1.0, 0, 0])) == "forward"
    assert describe(np.array([0, -0.8, -0.6])) == "right and down"


@pytest.mark.parametrize("height", [-0.99, 0.0, 0.99])
def test_the_last_sector_ends_where_the_first_begins(height):
    """A direction along -x, whose azimuth is π, is in the sector of those a little before."""
    level = np.sqrt(1 - height**2)
    at, before = (np.array([[-level * np.cos(turn), level * np.sin(turn), height]]) for turn in (0.0, 1e-6))
    assert cell_of(at) == cell_of(before)
