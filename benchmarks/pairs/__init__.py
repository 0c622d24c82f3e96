"""Pairs of a simulation from MuJoCo and a recording from another physics, whose differences are known but sealed."""
