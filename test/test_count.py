"""The counts of ``make count``."""

from count import function_count, numeric_constant_count

SOURCE = """
LIMIT = 1.5
LEAST, MOST = 1, 2
NAMES: tuple[str, ...] = ("x", "y")
SWITCH = True
factor = 3

class Reader:
    SIZE = 8

    def read(self):
        def part():
            return 1
        return part
"""


def test_constants_are_capitals_of_a_module_with_a_number():
    """Of three assignments with numbers one has a small name; that of a class does not count."""
    assert numeric_constant_count(SOURCE) == 2


def test_functions_are_counted_at_every_depth():
    """Methods and nested functions too."""
    assert function_count(SOURCE) == 2
