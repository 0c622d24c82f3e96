import pytest

from tam_validation.blind.outcome import Outcome
from tam_validation.blind.score import LARGE, SMALL, Score


def key(kind="single", effects=("bias_jump",), gap=1.0, sensors=(2,), axes=(), **other):
    """Return a key."""
    causes = [
        {
            "effect": effect,
            "sensors": list(sensors),
            "axes": list(axes),
            "visible_gap": gap,
            "samples_changed": 400,
        }
        for effect in effects
    ]
    conditions = {"samples": 400, "sensors": 4, "motion": "tumbling", "with_scalar": True, "holes": False}
    sheet = {"noise_over_sheet": {"vector": 1.0, "scalar": 1.0}}
    key = {"kind": kind, "effects": causes, "visible_gap": gap, "withheld_channel": ""}
    return key | conditions | sheet | other


def answer(*named, verdict="explained", sensors=(2,), axes=("x", "y", "z"), closed=1.0, **other):
    """Return an answer."""
    causes = [
        {"effect": name, "sensors": list(sensors), "axes": list(axes), "probability": 0.9, "indistinguishable_from": []}
        for name in named
    ]
    where = {"sensors": list(sensors), "axes": list(axes)}
    gap = {"before": 1.0, "closed": closed}
    return {"verdict": verdict, "gap": gap, "where": where, "causes": causes, "considered": []} | other


def score(*cases):
    """Return the score of pairs of key and answer."""
    return Score([Outcome(f"case_{number:04d}", *case) for number, case in enumerate(cases, start=1)])


def value(result, name, size=""):
    """Return a figure by its name."""
    (row,) = [row for row in result.rows if row.name == name and row.size == size]
    return row.value


def test_first_cause_and_verdict():
    """A cause counts when it comes first and the verdict is that it explains the gap."""
    result = score(
        (key(), answer("bias_jump")),
        (key(), answer("temperature_drift", "bias_jump")),
        (key(), answer("bias_jump", verdict="partly_explained")),
        (key(), answer(verdict="unexplained")),
        (key(gap=0.3), answer("bias_jump")),
    )
    assert value(result, "first cause right, verdict right", LARGE) == 0.25
    assert value(result, "among the first three", LARGE) == 0.75
    assert value(result, "first cause right, verdict right", SMALL) == 1
    assert result.confusion["bias_jump"] == {"bias_jump": 3, "temperature_drift": 1, "unexplained": 1}
    assert result.false_attribution[0].hits == 1
    assert len(result.failures) == 3


def test_a_cause_that_the_verdict_does_not_stand_for_is_not_named():
    """With the verdict that there is no gap, or none known, no cause is named."""
    result = score((key(), answer("bias_jump", verdict="no_gap")))
    assert value(result, "first cause right, verdict right", LARGE) == 0


@pytest.mark.parametrize(
    ("true", "named", "other"),
    [
        ("time_skew", "eddy_current", {}),
        ("nonlinearity", "hysteresis", {}),
        ("temperature_drift", "bias_jump", {"withheld_channel": "temperature"}),
    ],
)
def test_partners_are_forgiven_apart(true, named, other):
    """A nested partner is wrong by the strict figure, and right by the forgiving one."""
    outcome = Outcome("case_0001", key(effects=(true,), **other), answer(named))
    assert not outcome.first_is_right
    assert outcome.first_is_tolerable
    assert not Outcome("case_0001", key(effects=("flexure",)), answer(named)).first_is_tolerable


def test_what_the_answer_says_it_cannot_tell_apart_is_forgiven():
    """A true cause among those that are indistinguishable from the one named is found, in the forgiving figure."""
    told = answer("geomagnetic_drift")
    told["causes"][0]["indistinguishable_from"] = ["bias_jump"]
    result = score((key(), told))
    assert value(result, "first cause right, verdict right", LARGE) == 0
    assert value(result, "the same, nested partners forgiven", LARGE) == 1


def test_few_clipped_samples_are_outliers():
    """Three clipped samples may be called outliers, four may not."""
    few, many = (key(effects=("saturation",)) for _ in range(2))
    few["effects"][0]["samples_changed"] = 3
    many["effects"][0]["samples_changed"] = 4
    assert Outcome("", few, answer("outliers")).first_is_tolerable
    assert not Outcome("", many, answer("outliers")).first_is_tolerable


def test_places():
    """A list of all sensors is everywhere; one sensor is not; the axis is right when it is the only one."""
    everywhere = key(sensors=("all",))
    result = score(
        (everywhere, answer("bias_jump", sensors=(1, 2, 3, 4))),
        (everywhere, answer("bias_jump", sensors=("all",))),
        (everywhere, answer("bias_jump", sensors=(2,))),
        (key(axes=("y",)), answer("bias_jump", axes=("y",))),
        (key(axes=("y",)), answer("bias_jump", axes=("x", "y"))),
    )
    assert value(result, "sensor, scalar or all right", LARGE) == 0.8
    assert value(result, "axis right (single-axis effects)", LARGE) == 0.5


def test_outside_the_library():
    """What no effect explains must be left unexplained, at the right sensor."""
    result = score(
        (key("outside", ("pressure_chirp",)), answer(verdict="unexplained")),
        (key("outside", ("pressure_chirp",)), answer(verdict="unexplained", sensors=(3,))),
        (key("outside", ("pressure_chirp",)), answer("temperature_drift")),
    )
    assert value(result, "outside the library → unexplained, sensor right", LARGE) == pytest.approx(1 / 3)
    assert result.false_attribution[0].hits == 1


def test_how_often_a_verdict_is_true():
    """Each verdict says something else, of which the key says whether it is so; short recordings do not count."""
    result = score(
        (key(), answer("bias_jump")),
        (key(), answer("temperature_drift")),
        (key(), answer("bias_jump", verdict="unexplained")),
        (key("outside", ("pressure_chirp",)), answer("", verdict="unexplained")),
        (key("clean", ()), answer("", verdict="no_gap")),
        (key("short"), answer("bias_jump")),
    )
    counts = {name: (rate.hits, rate.cases) for name, rate in result.by_verdict.items()}
    assert counts == {"no_gap": (1, 1), "explained": (1, 2), "partly_explained": (0, 0), "unexplained": (1, 2)}


def test_amplitude_left():
    """The amplitude left is the root of the energy left; the worst effect is named."""
    result = score(
        (key(), answer("bias_jump", closed=1.0)),
        (key(), answer("bias_jump", closed=1.0)),
        (key(effects=("flexure",)), answer("flexure", closed=0.91)),
    )
    assert value(result, "amplitude left, median", LARGE) == 0
    (worst,) = [row for row in result.rows if row.name.startswith("amplitude left, worst") and row.size == LARGE]
    assert worst.value == pytest.approx(0.3)
    assert worst.remark == "flexure" and not worst.is_met


def test_pairs():
    """Both causes must be named and no other; what is named besides is spurious."""
    two = key("pair", ("bias_jump", "flexure"))
    result = score(
        (two, answer("flexure", "bias_jump")),
        (two, answer("flexure")),
        (two, answer("flexure", "bias_jump", "hysteresis")),
        (two, answer("flexure", verdict="partly_explained")),
    )
    assert value(result, "both of two effects found, none spurious") == 0.25
    assert value(result, "a spurious cause with two effects") == 0.25


def test_clean_and_withheld():
    """Clean data have no gap; without its channel a cause is left open, or named wrongly."""
    withheld = key("withheld", ("current_interference",), withheld_channel="current")
    result = score(
        (key("clean", ()), answer(verdict="no_gap")),
        (key("clean", ()), answer("outliers")),
        (withheld, answer(verdict="unexplained")),
        (withheld, answer("bias_jump")),
    )
    assert value(result, "clean data → no_gap") == 0.5
    assert value(result, "deciding channel withheld: wrong name") == 0.5


def test_probabilities_of_no_gap_and_none():
    """What is told of no gap and of no cause known counts as that of an effect does."""
    told = {"no_gap": 0.9, "none": 0.05, "bias_jump": 0.05}
    result = score((key("clean", ()), answer(verdict="no_gap", probabilities=told)))
    assert [(one.told, one.true, one.count) for one in result.reliability] == [(0.05, 0, 2), (0.9, 1, 1)]
    assert value(result, "probabilities calibrated (reliability error)") == pytest.approx((2 * 0.05 + 0.1) / 3)


def test_left_out_of_the_library():
    """Without the true effect the answer is that none explains it, or a nested partner."""
    cases = [
        Outcome("", key(), answer(verdict="unexplained")),
        Outcome("", key(), answer("hysteresis")),
        Outcome("", key(effects=("time_skew",)), answer("eddy_current")),
    ]
    result = Score([], cases)
    assert value(result, "true effect left out of the library → unexplained or a partner") == pytest.approx(2 / 3)


def test_no_answer_is_a_failure_with_its_reason():
    """A diagnosis that ends in an error is listed with what it said."""
    result = score((key(), {"verdict": "error", "why": "tam: it is full of holes"}))
    assert "error (tam: it is full of holes)" in result.failures[0].line


def mixture(outside="random_walk_bias", named=""):
    """Return the key of a jump in sensor 2 beside an outside cause in sensor 3."""
    made = key("mixed", ("bias_jump", outside))
    made["effects"][1] |= {"sensors": [3], "named": named}
    return made


def test_a_known_cause_beside_an_unknown_one():
    """The known one must be named, nothing else, and the verdict be that it explains a part."""
    result = score(
        (mixture(), answer("bias_jump", verdict="partly_explained")),
        (mixture(), answer("bias_jump")),
        (mixture(), answer("bias_jump", "flexure", verdict="partly_explained")),
        (mixture(), answer(verdict="unexplained")),
    )
    name = "known with unknown: "
    assert value(result, f"{name}partly_explained, the known named, nothing else") == 0.25
    assert value(result, f"{name}the known named") == 0.75
    assert value(result, f"{name}nothing else named") == 0.75
    assert value(result, f"{name}verdict partly_explained") == 0.5
    assert len(result.failures) == 3


def test_an_outside_cause_with_a_name_since():
    """Either no name is right or that name, alone and beside a known cause; another one is not."""
    single = key("outside", ("two_state_gain",))
    single["effects"][0]["named"] = "gain_switching"
    both = mixture("two_state_gain", "gain_switching")
    result = score(
        (single, answer("gain_switching")),
        (single, answer(verdict="unexplained")),
        (single, answer("crosstalk")),
        (both, answer("bias_jump", "gain_switching")),
        (both, answer("bias_jump", verdict="partly_explained")),
    )
    assert value(result, "outside the library → unexplained, sensor right", LARGE) == pytest.approx(2 / 3)
    assert value(result, "known with unknown: partly_explained, the known named, nothing else") == 1
    assert result.false_attribution[0].hits == 1


def test_gaps_of_thirty_and_a_thousand_floors():
    """Each size has its own figures, of the first cause by name and of the place."""
    result = score(
        (key("large", gap=30.0), answer("bias_jump")),
        (key("large", gap=30.0), answer("bias_jump", sensors=(3,))),
        (key("large", gap=1000.0), answer("temperature_drift", verdict="partly_explained")),
    )
    assert value(result, "first cause right", "g = 30") == 1
    assert value(result, "sensor, scalar or all right", "g = 30") == 0.5
    assert value(result, "first cause right", "g = 1000") == 0
    assert value(result, "sensor, scalar or all right", "g = 1000") == 1


def test_probabilities_are_compared_with_a_constant_of_the_verdict():
    """Told certainty where it is right and doubt where it is wrong beats the constant; the same for all does not."""
    knowing, constant = (
        score(
            *((key(), answer("bias_jump", probabilities={"bias_jump": right})) for _ in range(8)),
            *((key(), answer("flexure", probabilities={"flexure": wrong})) for _ in range(2)),
        )
        for right, wrong in ((0.99, 0.05), (0.75, 0.75))
    )
    name = "log score over that of a constant per verdict"
    assert value(knowing, name) < 0.1
    assert value(constant, name) == pytest.approx(1)
    assert value(knowing, "right and wrong separated (AUROC)") == 1
    assert value(constant, "right and wrong separated (AUROC)") == 0.5


def test_sets_hold_the_cause_unknown_or_no_gap():
    """A set holds the truth by its name; answers that tell no set do not count."""
    result = score(
        (key(), answer("bias_jump", set_95=["bias_jump"])),
        (key(), answer("flexure", set_95=["flexure", "unknown"])),
        (key("outside", ("stiction",)), answer(verdict="unexplained", set_95=["unknown", "flexure", "outliers"])),
        (key("clean", ()), answer(verdict="no_gap", set_95=["no_gap"])),
        (key(), answer("bias_jump")),
    )
    assert value(result, "95 % sets contain the true cause") == 0.75
    assert value(result, "95 % sets, median size") == 1.5
    old = score((key(), answer("bias_jump")))
    assert [row.cases for row in old.rows if row.name.startswith("95 % sets")] == [0, 0]


def test_intervals_of_coefficients():
    """Within 1.96 standard errors is held; what only one of both states does not count."""
    told = answer("bias_jump")
    told["causes"][0]["parameters"] = {
        "sensor 2 x offset": {"value": 10.0, "standard_error": 1.0, "unit": "nT"},
        "sensor 2 y offset": {"value": 10.0, "standard_error": 1.0, "unit": "nT"},
        "time": {"value": 3.0, "standard_error": None, "unit": "s"},
    }
    sized = key()
    sized["effects"][0]["coefficients"] = {"sensor 2 x offset": 11.9, "sensor 2 y offset": 12.1, "time": 3.0}
    result = score((sized, told), (key(), told))
    (row,) = [row for row in result.rows if row.name.startswith("95 % intervals") and not row.size]
    assert (row.value, row.cases, row.is_met) == (0.5, 2, False)


def test_laws_courses_and_places():
    """A law counts with its place and axis; a place among those that the answer cannot tell apart counts too."""
    true = key(axes=("x",))
    true["effects"][0] |= {"law": ["offset"], "course": ["step"]}
    stated = {"law": "offset", "course": "step", "sensors": [2], "axes": ["x"], "places": [[2]]}

    def answered(**other):
        return answer("bias_jump", signature=[stated | other])

    result = score(
        (true, answered()),
        (true, answered(law="gain")),
        (true, answered(axes=["y"])),
        (true, answered(sensors=[1], places=[[1], [2]], course="slow")),
    )
    assert value(result, "law, sensor and axes right", "g ≥ 1") == 0.5
    assert value(result, "course right") == 0.75


def test_both_of_two_laws():
    """Of two causes each has its law, in any order; of clean recordings none is stated."""
    both = key("pair", effects=("bias_jump", "time_skew"))
    both["effects"][0] |= {"law": ["offset"], "course": ["step"]}
    both["effects"][1] |= {"law": ["rate"], "course": ["constant"]}
    laws = [
        {"law": law, "course": course, "sensors": [2], "axes": []}
        for law, course in (("rate", "constant"), ("offset", "step"))
    ]
    clean = key("clean", effects=())
    result = score(
        (both, answer("bias_jump", signature=laws)),
        (both, answer("bias_jump", signature=laws[:1])),
        (clean, answer(verdict="no_gap", signature=[])),
    )
    assert value(result, "both of two laws") == 0.5
    assert value(result, "clean: no law") == 1
