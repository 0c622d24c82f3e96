"""`tam call`: call a service of the nodes where there is no `ros2` command."""

import click

from tam_calibration.nodes import ros_session

FIND_S = 5.0


@click.command()
@click.argument("service")
def command(service: str) -> None:
    """Call SERVICE, such as calibrator/calibrate, and print its answer; exit 1 when the answer is no."""
    with ros_session(exit_code=1):
        from tam_calibration.nodes.trigger import call

        click.echo(call(service, FIND_S))
