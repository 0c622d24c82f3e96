import ast
from pathlib import Path

ROOM = Path(__file__).parents[2] / "tam_calibration" / "blind"


def test_the_check_shares_no_code_with_what_it_checks():
    """The room of the check imports nothing of the package but itself, its units and its problems."""
    names = set()
    for path in ROOM.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                names.add(node.module)
            elif isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
    own = {name.split(".")[1] for name in names if name.startswith("tam_calibration.")}
    assert own <= {"blind", "exceptions", "units"}
    assert "tam_calibration" not in names
