"""Cases that `make thorough` has and `make test` leaves out."""

import pytest


def thorough(*cases):
    """Parameters with the mark: each case is a value, or a tuple of the values of several."""
    values = (case if isinstance(case, tuple) else (case,) for case in cases)
    return [pytest.param(*one, marks=pytest.mark.thorough) for one in values]
