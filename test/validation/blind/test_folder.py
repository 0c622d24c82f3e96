import pytest

from tam_calibration.model.exceptions import Refused
from tam_validation.blind.folder import check_seals, seal


def test_a_sealed_key_opens():
    """What was committed to passes, and the commitment does not tell the key: each seal is another."""
    key = {"kind": "clean", "effects": []}
    first, commitment = seal(key)
    check_seals({"case_0001": first}, {"case_0001": commitment})
    assert seal(key)[1] != commitment
    assert {name: first[name] for name in key} == key


def test_an_altered_key_is_refused():
    """A key that was changed after the commitment is named."""
    sealed, commitment = seal({"kind": "clean", "effects": []})
    with pytest.raises(Refused, match="the key of case_0001 is not the one that was committed to"):
        check_seals({"case_0001": {**sealed, "kind": "outside"}}, {"case_0001": commitment})


def test_a_key_that_is_kept_back_is_refused():
    """No case can be left out of the score."""
    with pytest.raises(Refused, match="the key of case_0002 is missing"):
        check_seals({}, {"case_0002": "0"})
