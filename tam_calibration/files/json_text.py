"""JSON text: numbers are finite or null."""

import json
import math
from collections.abc import Mapping
from typing import Any


def to_json(content: Mapping[str, Any]) -> str:
    """Return JSON text; NaN and infinity, which JSON has not, become null."""
    return json.dumps(_without_nan(content), ensure_ascii=False, indent=1)


def _without_nan(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {key: _without_nan(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_without_nan(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
