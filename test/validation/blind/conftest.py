import numpy as np
import pytest

from tam_validation.blind.catalogue import CAUSES
from tam_validation.blind.continuous_motion import MOTIONS
from tam_validation.blind.scene import Wish, draw_scene


@pytest.fixture
def draw():
    """Return a function that draws a scene with all channels."""

    def drawing(seed, samples=400, sensor_count=4, motions=("tumbling",), with_scalar=True):
        wish = Wish(samples, sensor_count, motions, with_scalar, False, ("attitude", "current", "temperature"))
        return draw_scene(np.random.default_rng(seed), wish)

    return drawing


@pytest.fixture(params=MOTIONS)
def motion(request):
    """Return each kind of motion in turn."""
    return request.param


@pytest.fixture
def change_of(draw):
    """Return a function that draws a cause, and what it adds to its sensor at an amplitude of one, with the scene."""

    def changing(name, seed, amplitude=1.0, **wish):
        scene = draw(seed, **wish)
        cause = CAUSES[name].draw(np.random.default_rng(seed), scene)
        vectors, _ = cause.change(amplitude, (scene.readings_T, scene.intensity_T))
        return scene, cause, vectors[:, cause.sensors[0] - 1]

    return changing
