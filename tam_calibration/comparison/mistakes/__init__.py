"""Gross mistakes of simulators: units, frames, the world's field and noise, found before anything is fitted."""
