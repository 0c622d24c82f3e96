"""Libraries that only some commands need: not all of them are in Ubuntu, and a robot has no use for them."""

from importlib import import_module

from tam_calibration.model.exceptions import InputError

EXTRAS = {
    "bags": ("rosbags", "zstandard", "lz4"),
    "report": ("jinja2", "matplotlib"),
    "fleet": ("distributed",),
    "compare": ("mujoco",),
    "tables": ("pandas", "pyarrow"),
}
"""What each extra of setup.py brings, by the names of the modules."""

_UBUNTU = {"report": "sudo apt install python3-jinja2 python3-matplotlib, or "}
"""How to get the extras that Ubuntu has, in versions that will do."""


def require(extra: str, purpose: str) -> None:
    """Check that the libraries of an extra are installed.

    Parameters
    ----------
    extra : str
        A name in `EXTRAS`.
    purpose : str
        What needs it, the subject of the sentence.

    Raises
    ------
    InputError
        When one is missing; the sentence says how to install it, also where Python is managed by the system.
    """
    for library in EXTRAS[extra]:
        try:
            import_module(library)
        except ModuleNotFoundError:
            pip = f"pip install 'tam_calibration[{extra}]' in a virtual environment"
            remedy = f"{_UBUNTU.get(extra, '')}{pip} (python3 -m venv --system-site-packages)"
            raise InputError(f"{purpose} needs {library}: {remedy}") from None
