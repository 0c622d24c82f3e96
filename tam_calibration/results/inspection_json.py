"""An inspection as JSON: the names of its classes' attributes, and ranges of fields in nT."""

from dataclasses import asdict
from typing import Any

from tam_calibration.recordings.channel_map import map_to_mapping
from tam_calibration.recordings.inspection_result import Inspection

_SCHEMA = "tam_calibration/inspection/1"


def inspection_to_mapping(found: Inspection) -> dict[str, Any]:
    """Return the content of an inspection's JSON.

    Parameters
    ----------
    found : Inspection
        What a recording contains. Courses over time are left out.
    """
    content = asdict(found) | {"files": [str(file) for file in found.files], "is_certain": found.is_certain}
    content["channel_map"] = None if found.channel_map is None else map_to_mapping(found.channel_map)
    for table, inspected in zip(content["tables"], found.tables, strict=True):
        for channel, own in zip(table["channels"], inspected.channels, strict=True):
            del channel["course"]
            if own.unit:
                channel["size_nT"] = own.size * own.nanotesla
                for name in ("low", "high"):
                    channel[f"{name}_nT"] = [value * own.nanotesla for value in channel[name]]
    return {"schema": _SCHEMA, **content}
