import sys

import numpy as np
import pandas
import pytest
import xarray

from tam_calibration import InputError, Recording
from tam_calibration.messages.point_cloud import SampleLayout

COUNT, SENSORS = 5, 2


def recording(**channels):
    """Return a recording without a value that is there twice."""
    readings_T = 1e-6 * (1 + np.arange(COUNT * SENSORS * 3.0)).reshape(COUNT, SENSORS, 3)
    return Recording(0.1 * np.arange(COUNT), readings_T, **channels)


FULL = recording(
    scalar_T=np.array([5e-5, np.nan, 5.1e-5, 5.2e-5, 5.3e-5]),
    temperature_C=np.linspace(10, 11, COUNT),
    current_A=np.linspace(0, 1, COUNT),
    attitude=np.array([[1.0, 2, 3, 4 + index] for index in range(COUNT)]),
    further={"current_2_A": np.linspace(1, 2, COUNT), "actuator_rudder": np.linspace(-1, 1, COUNT)},
)
CASES = pytest.mark.parametrize("case", [FULL, recording()], ids=["every channel", "no channel"])


def assert_same(one, other):
    """Check that two recordings hold the same, to the last bit."""
    assert list(one.values()) == list(other.values())
    for name, values in one.values().items():
        np.testing.assert_array_equal(values, other.values()[name])


@CASES
def test_a_table_holds_the_recording(case):
    """There and back nothing changes; the columns are those of the samples on the topics, which the CSV's are too."""
    frame = case.to_pandas()
    assert ("time_s", *frame.columns) == SampleLayout.of(case).columns
    np.testing.assert_array_equal(frame.reset_index().to_numpy(), SampleLayout.of(case).rows(case))
    assert_same(Recording.from_pandas(frame), case)


@CASES
def test_a_dataset_holds_the_recording(case):
    """There and back nothing changes, and what is labelled is where the label says."""
    dataset = case.to_xarray()
    np.testing.assert_array_equal(dataset["readings_T"].sel(sensor=2, axis="z"), case.readings_T[:, 1, 2])
    assert_same(Recording.from_xarray(dataset), case)


def test_columns_may_stand_in_any_order():
    """Also with the time among them, as in a file that pandas has read."""
    frame = FULL.to_pandas().reset_index()
    assert_same(Recording.from_pandas(frame[frame.columns[::-1]]), FULL)


def test_dimensions_and_components_may_stand_in_any_order():
    """A dataset is read by its labels."""
    dataset = FULL.to_xarray().transpose("axis", "quaternion", "sensor", "time_s")
    turned = dataset.sel(axis=["z", "x", "y"], quaternion=["w", "x", "y", "z"])
    assert_same(Recording.from_xarray(turned), FULL)


def test_a_missing_value_of_pandas_is_nan():
    """Such as ``pandas.NA``, which stands where an instrument was silent."""
    frame = FULL.to_pandas()
    frame["temperature_C"] = pandas.array([10, None, 11, 12, 13], dtype="Int64")
    np.testing.assert_array_equal(Recording.from_pandas(frame).temperature_C, [10, np.nan, 11, 12, 13])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda frame: frame.drop(columns="b2y_T"), "column b2y_nT is missing"),
        (lambda frame: frame.drop(columns="qz"), "column qz is missing"),
        (lambda frame: frame.iloc[:, 6:], "no vector of a magnetic field is recognised"),
        (lambda frame: frame.assign(scalar_T="much"), "not a number"),
        (lambda frame: pandas.concat([frame, frame[["scalar_T"]]], axis=1), "there twice"),
        (lambda frame: frame.iloc[::-1], "time goes backwards"),
    ],
)
def test_another_table_is_refused(change, words):
    """In one sentence that says what is wrong with it."""
    with pytest.raises(InputError, match=words):
        Recording.from_pandas(change(FULL.to_pandas()))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda dataset: dataset.drop_vars("readings_T"), "'readings_T' is missing"),
        (lambda dataset: dataset.drop_vars("time_s"), "'time_s' is missing"),
        (lambda dataset: dataset.drop_vars("axis"), "dimensions"),
        (lambda dataset: dataset.isel(axis=[0, 1]), "dimensions"),
        (lambda dataset: dataset.rename(sensor="magnetometer"), "dimensions"),
        (lambda dataset: dataset.rename(scalar_T="scalar"), "'scalar' is not known"),
        (lambda dataset: dataset.assign(scalar_T=dataset["scalar_T"].assign_attrs(units="nT")), "must be in 'T'"),
    ],
)
def test_another_dataset_is_refused(change, words):
    """In one sentence that says what is wrong with it."""
    with pytest.raises(InputError, match=words):
        Recording.from_xarray(change(FULL.to_xarray()))


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_a_library_that_is_not_installed_is_named(monkeypatch, name):
    """With what installs it; nothing else needs it."""
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=f"{name} is not installed: pip install"):
        getattr(FULL, f"to_{name}")()


def test_the_dataset_is_of_labelled_arrays():
    """Every variable tells its unit, so that plots are labelled."""
    dataset = FULL.to_xarray()
    assert isinstance(dataset, xarray.Dataset)
    assert {str(name): dataset[name].attrs["units"] for name in dataset.variables if name in vars(FULL)} == {
        "time_s": "s",
        "readings_T": "T",
        "scalar_T": "T",
        "temperature_C": "degC",
        "current_A": "A",
        "attitude": "1",
    }


def turned_frame(**time):
    """Return a table of one turned sensor in µT with columns of strange names, and a time."""
    angle = np.linspace(0, 60, 300)
    height = np.cos(angle / 20)
    flat = np.sqrt(1 - height**2)
    field = 48 * np.column_stack([flat * np.cos(angle), flat * np.sin(angle), height])
    return pandas.DataFrame({**time, **dict(zip(("BX", "BY", "BZ"), field.T, strict=True)), "station": "A"})


SINCE = 0.04 * np.arange(300)
MAP = {"sensors": [{"columns": ["BX", "BY", "BZ"], "unit": "uT"}]}


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_of_pandas_are_those_that_they_state(unit):
    """Timedeltas and datetimes of any resolution, with and without a zone, as a column or the index."""
    since_s = np.arange(300) * (1.0 if unit == "s" else 0.04)
    ticks = np.round(1e9 * since_s).astype("timedelta64[ns]").astype(f"timedelta64[{unit}]")
    moments = pandas.Series(np.datetime64("2024-05-14T08:30:00", unit) + ticks)
    for time, first_s in (
        (pandas.Series(ticks), 0.0),
        (moments, 1_715_675_400.0),
        (moments.dt.tz_localize("UTC").dt.tz_convert("Asia/Tokyo"), 1_715_675_400.0),
    ):
        for frame in (turned_frame(acquired=time), turned_frame(when=time).set_index("when")):
            recording = Recording.from_pandas(frame, map=MAP)
            np.testing.assert_allclose(recording.time_s, first_s + since_s, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("time_s", SINCE),
        ("time", SINCE),
        ("t_ms", np.round(1e3 * SINCE)),
        ("time_us", np.round(1e6 * SINCE)),
        ("timestamp", [f"1970-01-01T00:00:{second:06.3f}Z" for second in SINCE]),
    ],
)
def test_times_of_pandas_may_be_numbers_or_words(name, values):
    """With the unit of their name, or detected; without a map the vector is found by its name and the field's size."""
    for map in (MAP, None):
        recording = Recording.from_pandas(turned_frame(**{name: values}), map=map)
        np.testing.assert_allclose(recording.time_s, SINCE, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(recording.readings_T[:, 0], axis=1), 48e-6, rtol=1e-12)


def test_a_map_of_pandas_states_the_rest(tmp_path):
    """A rate where there is no time, a scale of counts, a channel, from a file; the table itself is not changed."""
    frame = turned_frame(**{"7": np.full(300, 21.5)}).rename(columns={"7": 7})
    before = frame.copy()
    text = '{sensors: [{columns: [2, 3, 4], scale_nT: 1000}], temperature: {column: "7"}, time: {rate_hz: 25}}'
    (tmp_path / "map.yaml").write_text(text)
    recording = Recording.from_pandas(frame, map=tmp_path / "map.yaml")
    np.testing.assert_allclose(recording.time_s, SINCE)
    np.testing.assert_allclose(recording.readings_T[:, 0], 1e-6 * frame[["BX", "BY", "BZ"]].to_numpy())
    assert (recording.temperature_C == 21.5).all()
    pandas.testing.assert_frame_equal(frame, before)


@pytest.mark.parametrize(
    ("map", "sentence"),
    [
        ({"sensors": [{"columns": ["BX", "BY", "bz"]}]}, "has no 'bz': it has BX, BY, BZ"),
        ({"sensors": [{"columns": ["BX", "BY", "station"]}]}, "'station'"),
        ({"sensors": [{"columns": ["BX", "BY"]}]}, "sensor 1 needs 3 numbers"),
        ({**MAP, "time": {"column": "clock"}}, "has no column 'clock'"),
        ({"sensor": []}, "sensor"),
    ],
)
def test_a_map_that_does_not_fit_a_table_of_pandas_is_told(map, sentence):
    """In one sentence, with what there is."""
    with pytest.raises(InputError, match=sentence) as told:
        Recording.from_pandas(turned_frame(time_s=SINCE), map=map)
    assert "\n" not in str(told.value)


def test_rows_of_pandas_that_lack_a_sensor_are_left_out():
    """As in a file."""
    frame = turned_frame(time_s=SINCE)
    frame.loc[[4, 90], "BY"] = np.nan
    recording = Recording.from_pandas(frame, map=MAP)
    np.testing.assert_allclose(recording.time_s, np.delete(SINCE, [4, 90]))
