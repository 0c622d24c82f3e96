"""Recordings of a known array in a known field: the truth that fits are judged by."""

from tam_calibration.simulation.observe import Scenario, Simulation, simulate

__all__ = ["Scenario", "Simulation", "simulate"]
