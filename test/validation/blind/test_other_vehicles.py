"""Vehicles of other kinds: what is recorded beside each, and that none answers by more than nature."""

import numpy as np
import pytest
from numpy.linalg import norm

from tam_calibration.validation.blind.case import make_case
from tam_calibration.validation.blind.case_plan import CasePlan
from tam_calibration.validation.blind.catalogue import CATALOGUE
from tam_calibration.validation.blind.continuous_motion import VOYAGES
from tam_calibration.validation.blind.further_vehicles import FURTHER_VEHICLES
from tam_calibration.validation.blind.later_vehicles import LATER_VEHICLES
from tam_calibration.validation.blind.other_vehicles import OTHER_VEHICLES

TABS = {"actuator_tab_port", "actuator_tab_starboard"}
COLUMNS = {"trim_tabs": TABS, "motor": {"actuator_motor"}, "batteries": {"current_2_A", "current_3_A"}}
COLUMNS |= {"arm": {"actuator_arm"}, "pump": {"actuator_pump"}, "electrodes": {"current_2_A", "current_3_A"}}
COLUMNS |= {"trolley": {"actuator_trolley"}, "strut": {"actuator_strut"}, "ram": {"actuator_ram"}}
COLUMNS |= {"tether": {"current_2_A"}, "panels": {"current_2_A", "current_3_A"}, "heater": {"current_2_A"}}


KINDS = OTHER_VEHICLES | FURTHER_VEHICLES | LATER_VEHICLES


@pytest.fixture(params=KINDS)
def kind(request):
    """Return each kind in turn."""
    return request.param


def test_the_field_is_that_of_the_vehicle_at_every_sensor(kind, draw):
    """Nothing of it is NaN or still, what moves is recorded, and conductors have a size that nature has."""
    scene = draw(4, motions=VOYAGES)
    cause = KINDS[kind].draw(np.random.default_rng(4), scene)
    vectors, scalar = cause.change(1.0, (scene.readings_T, scene.intensity_T))
    assert np.isfinite(vectors).all()
    assert np.isfinite(scalar).all()
    assert (vectors.std(axis=0) > 0).all()
    assert scalar.std() > 0
    for part, names in COLUMNS.items():
        assert not kind.endswith(part) or set(cause.columns) == names
    assert all(len(values) == scene.sample_count for values in cause.columns.values())
    conductors = ("frame", "plates", "spheres", "shafts", "hulls", "pipes", "hoops", "casks", "blades", "coils", "net")
    assert np.isfinite(cause.largest_amplitude) == kind.removeprefix("vehicle_with_").startswith(conductors)


def test_no_conductor_answers_by_more_than_a_perfect_one(draw):
    """At their largest amplitude spheres and the iron beside them change less than the field itself."""
    scene = draw(4, motions=VOYAGES)
    cause = OTHER_VEHICLES["vehicle_with_spheres"].draw(np.random.default_rng(4), scene)
    largest = cause.change(cause.largest_amplitude, (scene.readings_T, scene.intensity_T))[0]
    assert norm(largest - largest.mean(axis=0), axis=2).max() < norm(scene.field_T, axis=1).min()


def test_a_case_is_called_by_the_name_of_the_effect():
    """Its key names the vehicle's own field; what is stronger than nature is drawn again; no set of cases holds it."""
    case = make_case(CasePlan("single", ("vehicle_with_shafts",), (0.3,)), 5, 1)
    assert [one["effect"] for one in case.key["effects"]] == ["platform_field"]
    assert case.key["motion"] in VOYAGES
    assert case.key["visible_gap"] == pytest.approx(0.3, rel=0.02)
    assert not set(KINDS) & set(CATALOGUE)
