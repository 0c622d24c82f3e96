"""What is known of one foreign recording: how it is made, and what its user would type."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from foreign.truth import CROSS, Truth

DIRECT = ("calibrate {file} --array array.yaml -o cal.yaml",)
INSPECTED = (
    "inspect {file} --array array.yaml --write-map map.yaml",
    "calibrate {file} --map map.yaml --array array.yaml -o cal.yaml",
)
MAPPED = ("calibrate {file} --map map.yaml --array array.yaml -o cal.yaml",)
UNWRAPPED = ("calibrate {file} --array array.yaml --unwrap -o cal.yaml",)

CROSS_ARRAY = "{baseline_m: 0.5, vector_noise_nT: 1.0, scalar_noise_nT: 0.1}\n"


@dataclass(frozen=True)
class Foreign:
    """One recording.

    Parameters
    ----------
    file : str
        What its maker writes into a folder, and its user gives to the commands.
    make : callable
        Writes it to a path, from a truth.
    commands : tuple of str
        What follows ``tam``.
    truth : Truth
        What was recorded.
    array : str
        Text of the array file.
    map : str
        Text of the map that its user writes by hand, if any.
    sentence : tuple of str
        Where a refusal is right too: its one sentence holds one of these words.
    """

    file: str
    make: Callable[[Path, Truth], None]
    commands: tuple[str, ...] = DIRECT
    truth: Truth = CROSS
    array: str = CROSS_ARRAY
    map: str = ""
    sentence: tuple[str, ...] = ()

    def write(self, folder):
        """Write the recording, its array file and any map into a folder; return the path of the recording."""
        (folder / "array.yaml").write_text(self.array)
        if self.map:
            (folder / "map.yaml").write_text(self.map)
        self.make(folder / self.file, self.truth)
        return folder / self.file
