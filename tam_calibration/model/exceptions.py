"""The two ways in which a user's request can end without a result."""


class InputError(ValueError):
    """The input cannot be used; the message says what is wrong, where, and what would mend it."""


class Refused(RuntimeError):
    """The input is sound but the answer is no; the message gives the reason."""
