"""A set of cases on disk: case_0001/data.csv and spec.yaml, commitments.json beside them, keys.json apart."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.blind.case import Case
from tam_calibration.problems import InputError


def case_name(number: int) -> str:
    """Return the folder's name of a case."""
    return f"case_{number:04d}"


def write_case(folder: Path, case: Case) -> None:
    """Write what is given out of a case; fields to 1e-6 nT."""
    folder.mkdir(parents=True, exist_ok=True)
    table = np.stack(list(case.columns.values()), axis=1)
    np.savetxt(folder / "data.csv", table, fmt="%.6f", delimiter=",", header=",".join(case.columns), comments="")
    # JSON is YAML too.
    lines = [f"{name}: {json.dumps(value)}\n" for name, value in case.array.items()]
    (folder / "spec.yaml").write_text("".join(lines), encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file."""
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    InputError
        When it is none.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist") from None
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise InputError(f"{path} is not a JSON file") from None
