"""`tam export`: a calibration in the form that an autopilot, a driver or a program reads."""

from pathlib import Path

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import PATH, write_together
from tam_calibration.files.text_files import check_writable
from tam_calibration.results import read_calibration
from tam_calibration.results.export import CONSUMERS, export


@click.command()
@click.argument("calibration_path", metavar="CALIBRATION", type=PATH)
@click.option("--to", "target", type=click.Choice(list(CONSUMERS)), required=True, help="Software that will read it.")
@click.option("-o", "--output", type=PATH, help="File to write; NAME_1, NAME_2 and so on if each sensor has its own.")
def command(calibration_path: Path, target: str, output: Path | None) -> None:
    """Write CALIBRATION for other software, and say what that cannot represent.

    Without --output a single file is printed; a file for each sensor is named after CALIBRATION.
    """
    exported = export(read_calibration(calibration_path), target)
    numbers = [f"_{number}" for number in range(1, len(exported.texts) + 1)] if len(exported.texts) > 1 else [""]
    if output is None and len(numbers) > 1:
        output = Path(f"{calibration_path.stem}_{target}{CONSUMERS[target].suffix}")
    if output is None:
        say(exported.texts[0].removesuffix("\n"))
    else:
        check_writable(str(output))
        paths = {number: output.with_name(f"{output.stem}{number}{output.suffix}") for number in numbers}
        with write_together(paths, [calibration_path]) as places:
            for number, text in zip(numbers, exported.texts, strict=True):
                places[number].write_text(text, encoding="utf-8")
        for path in paths.values():
            say(f"{path}: written for {target}")
    for loss in exported.losses:
        say(loss.sentence, err=output is None)
