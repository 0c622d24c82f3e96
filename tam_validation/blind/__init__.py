"""The check on withheld effects: recordings with known causes from a physics of their own, sealed keys, the score.

Nothing here is shared with the diagnosis that it checks: no model, no basis, no noise, no fit.
"""

KINDS = ("single", "pair", "outside", "clean", "withheld", "short", "mixed", "large")
"""Kinds of cases."""

SETS = ("first", "fourteenth", "fifteenth", "sixteenth")
"""Sets of causes outside the library: rules of a diagnosis may be tuned on those that were judged before."""
