"""The notebook of the examples."""

import json
from pathlib import Path

NOTEBOOK = Path(__file__).parents[2] / "examples" / "calibrate.ipynb"


def test_its_cells_run_in_order(tmp_path, monkeypatch):
    """From an empty folder they find the drift, take it off down to the noise, and write both files."""
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names = {}
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        exec("".join(cell["source"]), names)
    assert names["effects"] == ["temperature_drift"]
    assert names["alone"].quality.grade != "good" and names["calibration"].quality.grade == "good"
    assert names["residual_nT"] < 1.0  # noise of four vectors of 1 nT over two, and of the scalar
    assert Path("calibration.yaml").is_file() and Path("px4.params").is_file()
