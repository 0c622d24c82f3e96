"""Keys that cannot be changed after the cases are given out: a commitment to each, opened by the scorer."""

import hashlib
import json
import secrets
from typing import Any

from tam_calibration.exceptions import Refused


def seal(key: dict[str, Any]) -> tuple[dict[str, Any], str]:
    """Return a key with a random nonce, and the SHA-256 of both."""
    sealed = {"nonce": secrets.token_hex(16), **key}
    return sealed, commitment(sealed)


def commitment(sealed: dict[str, Any]) -> str:
    """Return the SHA-256 of a key with its nonce."""
    return hashlib.sha256(json.dumps(sealed, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def check_seals(keys: dict[str, dict[str, Any]], commitments: dict[str, str]) -> None:
    """Hold the keys against what was committed to.

    Raises
    ------
    Refused
        When a key is not the one committed to, or is missing.
    """
    missing = sorted(set(commitments) - set(keys))
    if missing:
        raise Refused(f"the key of {missing[0]} is missing, though it was committed to")
    for name, sealed in keys.items():
        if commitments.get(name) != commitment(sealed):
            raise Refused(f"the key of {name} is not the one that was committed to: it was altered afterwards")
