"""A sound run, and how one channel of it is spoiled."""

from dataclasses import dataclass, replace

import pytest

from tam_calibration.integrity.check import faults_of
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


@dataclass(frozen=True, eq=False)
class Run:
    """A recording with its array."""

    recording: Recording
    array: Array

    def spoiled(self, change):
        """Return the run after a function has changed its readings (N, K, 3) in place."""
        readings_T = self.recording.readings_T.copy()
        change(readings_T)
        return replace(self, recording=replace(self.recording, readings_T=readings_T))

    def of(self, *sensors, **channels):
        """Return some of the sensors, numbered from 1, with the channels that are given."""
        index = [sensor - 1 for sensor in sensors]
        recording = Recording(self.recording.time_s, self.recording.readings_T[:, index], **channels)
        return Run(recording, Array(self.array.positions_m[index], self.array.vector_noise_T[index]))

    @property
    def faults(self):
        """What is found in it."""
        return faults_of(self.recording, self.array)

    @property
    def told(self):
        """Name, sensor and axis of each fault."""
        return [(fault.name, fault.sensor, fault.axis) for fault in self.faults]


@pytest.fixture(scope="session")
def run():
    """Return 15 s of a tumble at 100 Hz: four sensors, 1 nT of noise, a scalar."""
    scenario = replace(read_scenario("tumble_100_hz"), sample_count=1500)
    return Run(simulate(scenario).recording, scenario.array)


@pytest.fixture(scope="session")
def vehicle():
    """Return 150 s of a vehicle that tilts little, with attitude."""
    scenario = replace(read_scenario("auv"), sample_count=1500)
    return Run(simulate(scenario).recording, scenario.array)
