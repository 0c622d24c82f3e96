"""What a service answers when something goes wrong, without any process."""

from types import SimpleNamespace

import pytest

from tam_calibration.model.exceptions import InputError, Refused

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'tam_calibration[ros]'")


@pytest.mark.parametrize(
    ("problem", "said"),
    [
        (InputError("too few\nsamples"), "too few samples"),
        (Refused("not one calibration"), "not one calibration"),
        (ZeroDivisionError("by zero"), "a defect of this software: ZeroDivisionError('by zero')"),
    ],
)
def test_no_problem_of_an_action_ends_the_node(problem, said):
    """Bad data, a refusal and a defect are all answered with no and the reason on one line."""
    from tam_calibration.nodes.base import AnsweringNode

    def fail():
        raise problem

    silent = SimpleNamespace(info=str, warning=str, error=str)
    response = AnsweringNode._response(SimpleNamespace(get_logger=lambda: silent), fail)
    assert response.success is False
    assert response.message == said
