"""The options of `tam locate`: their values in SI, and which of them go together."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tam_calibration.cli.terminal import numbers_in
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import field_at
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.results.targets_file import Origin


@dataclass(frozen=True)
class Wanted:
    """What the options ask for, as they were given.

    Raises
    ------
    InputError
        When a value is out of its range, or options exclude each other.
    """

    index: float
    frequency: float | None
    find_frequency: bool
    velocity: str | None
    velocity_error: float | None
    position_error_m: float | None
    position_drift_m: float | None
    place: str | None
    attitude_noise_deg: float
    origin: str | None
    targets_path: Path | None

    def __post_init__(self) -> None:
        """Check each option, and those that exclude each other."""
        if self.frequency is not None and self.find_frequency:
            raise InputError("the frequency is either given or found: leave out --frequency or --find-frequency")
        if self.is_alternating and (self.velocity or self.place or self.attitude_noise_deg):
            raise InputError(
                "--velocity, --place and --attitude-noise-deg are for steady sources: leave out the frequency"
            )
        if not 0 <= self.attitude_noise_deg <= 180:
            raise InputError(
                f"--attitude-noise-deg must not be negative, nor above 180, not {self.attitude_noise_deg:g}"
            )
        error = self.velocity_error
        if error is not None and (self.velocity is None or not 0 <= error < np.inf):
            raise InputError("--velocity-error is that of --velocity: a finite number of m/s, not negative")
        for name, value in (("error", self.position_error_m), ("drift", self.position_drift_m)):
            if value is not None and not 0 <= value < np.inf:
                raise InputError(f"--position-{name}-m must be a finite number of metres, not negative, not {value:g}")
        _ = self.regional_T, self.speed, self.begin

    @property
    def is_alternating(self) -> bool:
        """Whether an alternating source is located."""
        return self.frequency is not None or self.find_frequency

    @property
    def attitude_noise(self) -> float:
        """Standard deviation of the attitude about each axis, radians."""
        return float(from_degrees(self.attitude_noise_deg))

    @cached_property
    def regional_T(self) -> FloatArray | None:
        """(3,) regional field of the place, tesla, in east, north, up; None where it is fitted."""
        return None if self.place is None else field_at(self.place)

    @cached_property
    def speed(self) -> FloatArray | None:
        """(3,) velocity on a straight track, m/s; None without one."""
        if self.velocity is None:
            return None
        return numbers_in("--velocity", "X,Y,Z in m/s such as 1.5,0,0", self.velocity, (3,))

    @cached_property
    def begin(self) -> Origin | None:
        """Latitude, longitude (degrees) and height (metres) where x = y = z = 0; None without ``--origin``."""
        if self.origin is None:
            return None
        values = numbers_in("--origin", "LAT,LON or LAT,LON,HEIGHT such as 54.3,10.1", self.origin, (2, 3))
        latitude, longitude, *height = values.tolist()
        if abs(latitude) > 90 or abs(longitude) > 360:
            raise InputError(f"--origin must be a latitude and a longitude in degrees, not {self.origin!r}")
        return latitude, longitude, height[0] if height else 0.0

    def are_lines(self, data: list[Recording]) -> bool:
        """Say whether recordings are survey lines.

        Raises
        ------
        InputError
            When they are, and options or positions do not suit lines.
        """
        has_positions = all(each.position_m is not None for each in data)
        is_plain = self.index == DIPOLE_INDEX and self.place is None and not self.is_alternating
        if self.velocity is None and not (has_positions and is_plain):
            return False
        if self.index != DIPOLE_INDEX:
            raise InputError(
                f"along a line dipoles are located: its structural index is 3, not {self.index:g}; leave out positions "
                "and velocity, and each sample is located by itself"
            )
        if self.place is not None:
            raise InputError("along a line the regional field is fitted: leave out --place")
        _require_one_frame(data)
        return True

    def require_one(self, data: list[Recording], of_lines: bool) -> None:
        """Check that a single recording without the options of lines is given.

        Raises
        ------
        InputError
            When there are more, or an option of lines.
        """
        if len(data) > 1:
            raise InputError("several recordings are located as survey lines alone, and one has no positions")
        if of_lines:
            raise InputError(
                "--targets and --grid are of survey lines: record positions or state --velocity, and leave out "
                "--index and --place"
            )
        if self.position_error_m is not None or self.position_drift_m is not None:
            raise InputError(
                "--position-error-m and --position-drift-m are those of positions, of which there are none"
            )


def _require_one_frame(data: list[Recording]) -> None:
    """Check that positions of several recordings do not all count from the begin of their own."""
    starts = [each.position_m[0] for each in data if each.position_m is not None]
    if len(data) > 1 and (len(starts) < len(data) or sum(not start.any() for start in starts) > 1):
        raise InputError(
            "several lines need positions in one frame, and these begin at 0, 0, 0 or have none: record x_m, y_m, z_m "
            "of one frame, or state the --origin from which latitudes and longitudes count"
        )
