"""The comparison file holds what programs were promised, in units of files."""

import json

from tam_calibration.comparison.mend import gazebo_sdf
from tam_calibration.correction.parts import Provenance
from tam_calibration.files.text_files import to_json
from tam_calibration.results.comparison_json import comparison_to_mapping, mend_to_mapping

PROMISED = (
    "schema",
    "verdict",
    "mistakes",
    "missing_in_simulation",
    "surplus_in_simulation",
    "other_parameters",
    "noise",
    "gap",
    "mend",
)
EFFECT = {"effect", "sensors", "axes", "probability", "parameters", "shown_by_simulation_run"}
NOISE = {"sensor", "axis", "simulation_nT", "recording_nT", "colour", "differs"}
GAP = {
    *("before", "after", "closed", "before_nT", "after_nT", "before_nT_per_m", "after_nT_per_m"),
    *("source_error_before_m", "source_error_after_m"),
}


def test_the_keys_are_those_of_the_schema(comparison):
    """Names and nesting are fixed; what is added stands beside them."""
    content = comparison_to_mapping(comparison)
    assert set(PROMISED) <= set(content)
    assert content["schema"] == "tam_calibration/compare/1" and content["verdict"] == "differs"
    (missing,), (surplus,), (other,) = (content[name] for name in PROMISED[3:6])
    assert set(missing) >= EFFECT and set(surplus) >= EFFECT
    assert {"effect", "simulation", "recording"} <= set(other)
    assert all(set(row) >= NOISE for row in content["noise"]) and len(content["noise"]) == 13
    assert set(content["gap"]) >= GAP
    assert set(content["mend"]) == {"sdf", "plugin", "parameters"}
    assert content["mend"]["parameters"] == mend_to_mapping(comparison.mend)
    assert content["mend"]["sdf"] == gazebo_sdf(comparison.mend)


def test_each_effect_has_its_place_and_parameters(comparison):
    """Of what is missing and surplus in units of files; of both, those of each side."""
    content = comparison_to_mapping(comparison)
    (missing,), (surplus,), (other,) = (content[name] for name in PROMISED[3:6])
    assert (missing["effect"], missing["sensors"], missing["axes"]) == ("temperature_drift", [2], ["x", "y", "z"])
    assert missing["parameters"]["sensor 2 y offset"] == {"value": 2.0, "standard_error": 0.02, "unit": "nT/°C"}
    assert (surplus["effect"], surplus["sensors"], surplus["parameters"]) == ("unknown", ["scalar"], {})
    values = [other[side]["parameters"]["sensor 2 x offset"]["value"] for side in ("simulation", "recording")]
    assert values == [1.0, 2.0]


def test_the_side_that_has_an_effect_shows_it(comparison):
    """The simulation's run could have shown the drift that it lacks; what it has, it shows, and the recording not."""
    content = comparison_to_mapping(comparison)
    (missing,), (surplus,) = content["missing_in_simulation"], content["surplus_in_simulation"]
    assert missing["shown_by_simulation_run"] and missing["shown_by_recording_run"]
    assert surplus["shown_by_simulation_run"] and not surplus["shown_by_recording_run"]


def test_sizes_are_in_units_of_files(comparison):
    """Tesla become nT, T/m nT/m; source errors are those that the simulation foretells wrongly."""
    content = comparison_to_mapping(comparison)
    gap = content["gap"]
    assert {name: gap[name] for name in ("before", "before_nT", "before_nT_per_m", "after_nT")} == {
        "before": 1.9,
        "before_nT": 1.9,
        "before_nT_per_m": 5.4,
        "after_nT": 0.2,
    }
    assert (gap["source_error_before_m"], gap["source_error_after_m"]) == (0.25, 0.02)
    assert [step["left"] for step in gap["steps"]] == [0.6, 0.2]
    rows = {(row["sensor"], row["axis"]): row for row in content["noise"]}
    assert (rows["scalar", None]["recording_nT"], rows["scalar", None]["colour"]) == (0.1, "white")
    band = rows[2, "y"]
    assert (band["simulation_nT"], band["recording_nT"], band["differs"]) == (1.0, 2.0, True)
    assert (band["simulation_colour"], band["colour"]) == ("white", "band")
    assert (band["simulation_standard_error_nT"], band["recording_standard_error_nT"]) == (0.02, 0.04)


def test_what_is_not_known_is_null(comparison):
    """As JSON has no NaN: the gradient after the mend, and the figure of the side that does not tell."""
    content = json.loads(to_json(comparison_to_mapping(comparison)))
    assert content["gap"]["after_nT_per_m"] is None
    bias = content["figures"][1]
    assert (bias["simulation"], bias["recording"], bias["unit"]) == (3.0, None, "nT")


def test_a_mistake_ends_the_comparison(mistaken):
    """It is told with place and mend; gap and mend, of which there are none, are null."""
    content = comparison_to_mapping(mistaken)
    (mistake,) = content["mistakes"]
    assert {"what", "where", "mend"} <= set(mistake) and mistake["kind"] == "gauss_for_tesla"
    assert content["gap"] is content["mend"] is None
    assert content["noise"] == content["missing_in_simulation"] == []


def test_the_file_names_the_two_recordings(comparison):
    """With size and digest; null for what is from no file."""
    source = Provenance("sim.mcap", 12, "ab" * 32)
    content = comparison_to_mapping(comparison, source)
    assert content["simulation"] == {"name": "sim.mcap", "size_bytes": 12, "sha256": "ab" * 32}
    assert content["recording"] is None
