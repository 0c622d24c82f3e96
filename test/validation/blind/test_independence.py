import ast
from pathlib import Path

ROOM = Path(__file__).parents[3] / "tam_validation" / "blind"


def test_the_check_shares_no_code_with_what_it_checks():
    """The room of the check imports of the package itself, units, problems, files and pages, and no numerics."""
    names = set()
    for path in ROOM.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                names.add(f"{node.module}.")
            elif isinstance(node, ast.Import):
                names |= {f"{alias.name}." for alias in node.names}
    own = {name for name in names if name.split(".")[0] in ("tam_calibration", "tam_validation")}
    assert len(own) > 20
    others = {name for name in own if not name.startswith("tam_validation.blind.")}
    allowed = (
        "tam_calibration.model.units",
        "tam_calibration.model.exceptions",
        "tam_calibration.files",
        "tam_calibration.report",
    )
    assert all(name.startswith(allowed) for name in others)
