"""Numerics that several rooms need, and that know nothing of what they are used for."""
