"""The battery of bad inputs: see ``python -m battery --help``."""
