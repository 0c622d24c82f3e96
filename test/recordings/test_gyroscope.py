"""The angular velocity of a gyroscope: recorded, written, read, turned and described."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration import read_array, read_recording
from tam_calibration.core.interpolation import AveragedRates
from tam_calibration.messages.point_cloud import IMU, MAGNETIC_FIELD
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting, quaternion_of
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_pieces
from tam_calibration.recordings.array_yaml import write_array
from tam_calibration.recordings.bag_writing import serialise, write_bag
from tam_calibration.recordings.fit_input import RecordingStream
from tam_calibration.recordings.inspection import inspect
from tam_calibration.results.data_files import write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


def recording(has_attitude=True):
    """Make forty samples of two sensors, of which every fifth has no angular velocity."""
    rng = np.random.default_rng(11)
    rates = rng.normal(size=(40, 3))
    rates[::5] = np.nan
    attitude = rng.normal(size=(40, 4)) if has_attitude else None
    readings = 3e-5 * rng.normal(size=(40, 2, 3))
    return Recording(np.arange(40) / 4, readings, attitude=attitude, angular_velocity_rad_s=rates)


@pytest.mark.parametrize("has_attitude", [True, False])
@pytest.mark.parametrize("name", ["run.csv", "run", "run.mcap"])
def test_what_is_written_is_read(tmp_path, name, has_attitude):
    """CSV and bags hold the angular velocity beside attitude or alone, and no value where there was none."""
    made = recording(has_attitude)
    write_recording(tmp_path / name, made)
    for read in (read_recording(tmp_path / name), RecordingStream(read_pieces(tmp_path / name)).whole()):
        assert np.array_equal(read.angular_velocity_rad_s, made.angular_velocity_rad_s, equal_nan=True)
        assert (read.attitude is not None) == has_attitude
    assert inspect(tmp_path / name).channel_map.gyroscope is not None


def test_tables_and_parts_keep_it():
    """Tables, datasets and parts of a recording hold the same values; one NaN makes all three NaN."""
    made = recording()
    for back in (Recording.from_pandas(made.to_pandas()), Recording.from_xarray(made.to_xarray())):
        assert np.array_equal(back.angular_velocity_rad_s, made.angular_velocity_rad_s, equal_nan=True)
    assert np.isfinite(made.take(slice(1, 5)).angular_velocity_rad_s).all()
    rates = made.angular_velocity_rad_s.copy()
    rates[1, 2] = np.nan
    assert np.isnan(replace(made, angular_velocity_rad_s=rates).angular_velocity_rad_s[1]).all()
    assert made.take(slice(0, 1)).angular_velocity_rad_s is None


def test_it_turns_with_the_imu():
    """An IMU that is turned by 90° about z reads along y of the array what it reads along its x."""
    mounting = Mounting(imu_rotation=quaternion_of(np.array([0.0, 0.0, np.pi / 2])))
    made = recording()
    turned = mounting.turned(made).angular_velocity_rad_s
    x, y, z = made.angular_velocity_rad_s.T
    np.testing.assert_allclose(turned, np.column_stack([-y, x, z]), atol=1e-12)


def test_an_array_file_states_it(tmp_path):
    """Density and bias come back from a file; what is left out stays open; no gyroscope is that bad."""
    stated = Gyroscope(np.radians(4.5e-3), np.radians(0.1))
    for gyroscope in (stated, Gyroscope(bias=0.01)):
        write_array(tmp_path / "array.yaml", replace(Array.cross(0.5), gyroscope=gyroscope))
        read = read_array(tmp_path / "array.yaml").gyroscope
        assert read.bias == pytest.approx(gyroscope.bias)
        assert read.noise_density == (gyroscope.noise_density and pytest.approx(gyroscope.noise_density))
    (tmp_path / "array.yaml").write_text("{baseline_m: 0.5, gyroscope: {noise_mdps_per_sqrt_Hz: -1}}")
    with pytest.raises(InputError, match="noise and bias of a gyroscope"):
        read_array(tmp_path / "array.yaml")


def test_a_simulated_gyroscope_reads_the_turn():
    """Angular velocities integrate to the true attitudes; noise has the stated density, and the bias is constant."""
    from scipy.spatial.transform import Rotation

    scenario = replace(read_scenario("auv"), sample_count=2000, rate_hz=10.0, gyroscope=Gyroscope(bias=1e-10))
    made = simulate(scenario)
    rotation = Rotation.from_quat(made.attitude)
    between = (rotation[:-1].inv() * rotation[1:]).as_rotvec() * scenario.rate_hz
    rates = made.recording.angular_velocity_rad_s
    np.testing.assert_allclose((rates[1:] + rates[:-1]) / 2, between, atol=2e-5)
    noisy = simulate(replace(scenario, gyroscope=Gyroscope(np.radians(4.5e-3), 0.002)))
    error = noisy.recording.angular_velocity_rad_s - rates
    np.testing.assert_allclose(error.std(axis=0), np.radians(4.5e-3) * np.sqrt(5), rtol=0.06)
    assert 1e-4 < np.abs(error.mean(axis=0)).max() < 0.006
    assert simulate(replace(scenario, gyroscope=None)).recording.angular_velocity_rad_s is None


def test_a_quick_gyroscope_counts_by_its_mean(tmp_path):
    """Of ten messages a sample the mean since the sample before is read, in whatever pieces."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    rng, period_ns, first_ns = np.random.default_rng(3), 100_000_000, 1_700_000_000_000_000_000
    rates = rng.normal(size=(400, 3))
    with write_bag(tmp_path / "run", "sqlite3") as writer:
        field = writer.add_connection("/tam_1/magnetic_field", MAGNETIC_FIELD, typestore=store)
        imu = writer.add_connection("/imu/data", IMU, typestore=store)
        for index in range(400):
            stamps = np.array([first_ns + index * period_ns // 10])
            none, known = np.array([-1.0, *[0.0] * 8]), np.zeros(9)
            numbers = np.concatenate([[0, 0, 0, 1], none, rates[index], known])[None]
            writer.write(imu, int(stamps[0]), serialise(IMU, numbers, stamps).tobytes())
            if index % 10 == 0:
                reading = 3e-5 * rng.normal(size=(1, 3))
                writer.write(field, int(stamps[0]), serialise(MAGNETIC_FIELD, reading, stamps).tobytes())
    means = np.vstack([rates[:1], rates[1:391].reshape(39, 10, 3).mean(axis=1)])
    expected = means.copy()
    expected[2:] -= 0.99 / 24 * np.diff(means, 2, axis=0)
    for read in (read_recording(tmp_path / "run"), RecordingStream(read_pieces(tmp_path / "run")).whole()):
        np.testing.assert_allclose(read.angular_velocity_rad_s, expected, atol=1e-12)


@pytest.mark.parametrize("quicker", [0.25, 1.0, 3.0])
def test_a_sample_that_needs_no_mean_has_the_same_angular_velocity(quicker):
    """For messages slower than the samples, as fast, and quicker, each a little late or early."""
    rng, count = np.random.default_rng(2), 200
    times = np.sort(np.arange(int(count * quicker)) * int(10_000_000 / quicker) + rng.integers(0, 2_000_000))
    rates = rng.normal(size=(len(times), 3))
    spared, averaged, skipped, taken = AveragedRates(), AveragedRates(), 0, 0
    for stamp in range(1_000_000, count * 10_000_000, 10_000_000):
        new = np.flatnonzero((times > stamp - 10_000_000) & (times <= stamp))
        taken = max(taken, *new.tolist()) if len(new) > 1 else int(new[0]) if len(new) else taken
        newest = rates[taken]
        for each in (spared, averaged):
            each.add(times[new], rates[new])
        expected = averaged.means(np.array([stamp]), newest[None])[0]
        if spared.skips(stamp, newest.tolist()):
            skipped, found = skipped + 1, newest
        else:
            found = spared.means(np.array([stamp]), newest[None])[0]
        np.testing.assert_array_equal(found, expected)
    assert skipped > 190 if quicker <= 1 else skipped < 10


def test_a_mean_of_a_swing_is_as_large_as_the_swing():
    """To a hundred thousandth, where the plain mean of ten is 0.06 % too small, in whatever pieces."""
    time_ns, omega = np.arange(100_000) * 10_000_000, 2 * np.pi / 5
    rates = np.sin(omega * time_ns / 1e9)[:, None] * [1.0, 0.5, 0.0]
    averaged, found = AveragedRates(), []
    for piece in np.array_split(np.arange(100_000), 2500):
        averaged.add(time_ns[piece], rates[piece])
        sampled = piece[piece % 10 == 0]
        found.append(averaged.means(time_ns[sampled], rates[sampled]))
    size = np.sqrt(2 * np.mean(np.concatenate(found)[50:] ** 2, axis=0))  # whole periods
    np.testing.assert_allclose(size, [1.0, 0.5, 0.0], atol=1e-5)
