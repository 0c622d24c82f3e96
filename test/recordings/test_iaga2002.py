"""Observatory files."""

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.iaga2002 import read_iaga2002

BOULDER = Path(__file__).parents[3] / "shared" / "data" / "usgs_boulder"

HEADER = """\
 Format                 IAGA-2002                                    |
 IAGA CODE              TST                                          |
 # A remark                                                          |
"""
HEZ = "DATE       TIME         DOY     TSTH      TSTE      TSTZ      TSTF   |"
ROWS = [
    "2016-01-01 00:00:00.000 001     20736.00    -99.00  47370.00  52248.00",
    "2016-01-01 00:01:00.000 001     20737.00    -95.00  47372.00  52249.00",
]


def write(folder, columns=HEZ, rows=ROWS, header=HEADER):
    """Write an observatory file and return its path."""
    path = folder / "tst.min"
    path.write_text(header + "\n".join([columns, *rows]) + "\n")
    return path


def test_components_and_times(tmp_path):
    """H, E, Z come in tesla with seconds from the first row."""
    record = read_iaga2002(write(tmp_path))
    assert record.start == datetime(2016, 1, 1)
    assert_array_equal(record.time_s, [0, 60])
    assert_allclose(record.field_T, [[20736e-9, -99e-9, 47370e-9], [20737e-9, -95e-9, 47372e-9]])


def test_missing_values_are_nan(tmp_path):
    """99999 and 88888 stand for no value."""
    rows = [ROWS[0].replace("-99.00", "99999.00"), ROWS[1].replace("47372.00", "88888.00")]
    field = read_iaga2002(write(tmp_path, rows=rows)).field_T
    assert_array_equal(np.isnan(field), [[False, True, False], [False, False, True]])


@pytest.mark.parametrize(
    ("letters", "convert"),
    [
        ("XYZF", lambda north, east: (north, east)),
        ("HDZF", lambda north, east: (np.hypot(north, east), np.degrees(np.arctan2(east, north)) * 60)),
    ],
)
def test_geographic_components_are_turned_into_the_meridian(tmp_path, letters, convert):
    """X Y and H D give the same components along and across the mean horizontal field."""
    along, across = np.array([20000.0, 20010.0]), np.array([-3.0, 3.0])
    declination = np.radians(9.0)
    north = along * np.cos(declination) - across * np.sin(declination)
    east = along * np.sin(declination) + across * np.cos(declination)
    first, second = convert(north, east)
    columns = "DATE TIME DOY " + " ".join(f"TST{letter}" for letter in letters) + " |"
    rows = [f"2016-01-01 00:0{n}:00.000 001 {first[n]:.9f} {second[n]:.9f} 47000.0 51000.0" for n in range(2)]
    field = read_iaga2002(write(tmp_path, columns, rows)).field_T
    assert_allclose(field[:, 2], 47000e-9)
    assert_allclose(field[:, 0], along * 1e-9, rtol=1e-7)
    assert_allclose(np.diff(field[:, 1]), 6e-9, rtol=0.01)


def test_real_observatory_month():
    """Four weeks of Boulder have their published level, and vary by tens of nT."""
    path = BOULDER / "BOU201601vmin.min"
    if not path.exists():
        pytest.skip(f"the observatory's file is not at {path}")
    record = read_iaga2002(path)
    assert_array_equal(np.diff(record.time_s), 60)
    intensity = np.linalg.norm(record.field_T, axis=1)
    # The published difference of the vector's intensity from the scalar's is -537 nT.
    assert_allclose(np.nanmean(intensity), (52258 - 537) * 1e-9, atol=30e-9)
    assert 5e-9 < np.nanstd(record.field_T[:, 0]) < 50e-9


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"header": "time_s,b1x_nT\n"}, "not an IAGA-2002 file"),
        ({"columns": "nothing"}, "the line DATE TIME DOY"),
        ({"rows": []}, "the file has no values"),
        ({"rows": [ROWS[0], ROWS[1][:60]]}, "line 6 does not hold date, time, day of year and 4 values"),
        ({"rows": [ROWS[0], ROWS[1].replace("20737.00", "twenty")]}, "line 6 does not hold"),
        ({"rows": ROWS[::-1]}, "time repeats or goes backwards"),
        ({"columns": HEZ.replace("TSTE", "TSTI")}, "the components are H I Z F; H E Z, H D Z or X Y Z are needed"),
    ],
)
def test_other_files_are_refused(tmp_path, changes, sentence):
    """What is wrong with the file is named with its line."""
    with pytest.raises(InputError, match=sentence):
        read_iaga2002(write(tmp_path, **changes))


@pytest.mark.parametrize("columns", [HEZ.replace("TSTE", "TSTD"), HEZ.replace("TSTH", "TSTX").replace("TSTE", "TSTY")])
@pytest.mark.parametrize(("old", "new"), [("20736.00", "99999.00"), ("-99.00", "nan"), ("-99.00", "-1e308")])
def test_rows_without_a_direction_are_refused(tmp_path, columns, old, new):
    """Each lacks one of the horizontal components, so that none tells the meridian."""
    with pytest.raises(InputError, match="no row has both horizontal components"):
        read_iaga2002(write(tmp_path, columns=columns, rows=[ROWS[0].replace(old, new)]))
