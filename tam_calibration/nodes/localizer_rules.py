"""The parameters of the localizer."""

from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.nodes.parameters import ARRAY_FILE, FRAME_ID, Rule

FITTED, NONE = "fitted", "none"
RULES = (
    ARRAY_FILE,
    FRAME_ID,
    Rule("calibration_file", "", "Calibration YAML that is loaded at the start; a newer one comes over `calibration`."),
    Rule(
        "index", DIPOLE_INDEX, "Structural index: 3 dipole, 2 line of dipoles, 1 line of current.", bounds=(0.1, 10.0)
    ),
    Rule(
        "regional",
        FITTED,
        "Field beside the source's, taken off with the attitude: fitted to the first samples, LAT,LON,DATE for IGRF "
        "there, or none.",
    ),
    Rule("regional_samples", 500, "Samples to which the regional field is fitted.", bounds=(1, 1_000_000)),
    Rule("attitude_noise_rad", 0.0, "Standard deviation of the attitude about each axis [rad].", bounds=(0.0, 1.0)),
    Rule(
        "batch_s",
        0.0,
        "Time for which samples are gathered to be located at once [s]; 0: each when it comes, at up to ten times the "
        "cost.",
        bounds=(0.0, 0.5),
    ),
    Rule(
        "fixed_frame",
        "",
        "Frame of what is published, with the axes of the attitude's world and the array's centre as origin; empty "
        "for the array frame.",
    ),
)
