"""Where ``config/`` is: the nodes' parameters, scenarios, the default array and the profile of Fast DDS."""

from pathlib import Path

from tam_calibration.model.exceptions import InputError


def configuration_folder() -> Path:
    """Return the folder ``config/`` that belongs to this package, however it was installed.

    In a source tree, to which an editable install and ``colcon build --symlink-install`` lead too, it is next to the
    package. Any other install has it in ``share/tam_calibration/config`` of a folder above the package, as
    ``/usr/share/tam_calibration/config`` for ``/usr/lib/python3/dist-packages/tam_calibration``.

    Raises
    ------
    InputError
        When it is in none of these places.
    """
    package = Path(__file__).resolve().parents[1]
    places = [package.parent / "config", *(folder / "share" / package.name / "config" for folder in package.parents)]
    for place in places:
        if (place / "tam.yaml").is_file():  # another package's folder may have the name config too
            return place
    raise InputError(
        f"the folder config is missing: it is neither next to {package}, nor share/{package.name}/config above it; "
        f"install {package.name} again"
    )
