"""Point clouds of float64 columns: how the nodes hand on samples and results."""

import array
import struct
from collections.abc import Sequence
from functools import cache

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from tam_calibration.pointcloud_layout import FLOAT64_SIZE, POINT_FIELD_FLOAT64, field_offsets
from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray


def make_cloud(header: Header, columns: tuple[str, ...], row: Sequence[float] = ()) -> PointCloud2:
    """Return a cloud of one row, or of none."""
    size = FLOAT64_SIZE * len(columns)
    cloud = PointCloud2(header=header, height=1, width=1 if row else 0, fields=_fields(columns))
    cloud.point_step, cloud.row_step, cloud.is_dense = size, size if row else 0, True
    cloud.data = array.array("B", struct.pack(f"<{len(row)}d", *row))
    return cloud


def read_cloud(cloud: PointCloud2) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the columns of a cloud and its (N, columns) rows.

    Raises
    ------
    InputError
        When the cloud is not made of little-endian float64 columns without gaps.
    """
    columns = tuple(field.name for field in cloud.fields)
    is_plain = all(
        field.offset == offset and field.datatype == POINT_FIELD_FLOAT64 and field.count == 1
        for field, (_, offset) in zip(cloud.fields, field_offsets(columns), strict=True)
    )
    if not is_plain or cloud.is_bigendian or cloud.point_step != FLOAT64_SIZE * len(columns):
        raise InputError("the point cloud is not made of little-endian float64 columns without gaps")
    if len(cloud.data) != cloud.width * cloud.height * cloud.point_step:
        raise InputError(f"the point cloud holds {len(cloud.data)} bytes, not {cloud.width * cloud.height} rows")
    return columns, np.frombuffer(cloud.data, "<f8").reshape(-1, max(len(columns), 1))


@cache
def _fields(columns: tuple[str, ...]) -> list[PointField]:
    return [
        PointField(name=name, offset=offset, datatype=POINT_FIELD_FLOAT64, count=1)
        for name, offset in field_offsets(columns)
    ]
