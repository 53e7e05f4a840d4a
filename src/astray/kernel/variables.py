"""Environment variables with which numba would fail to import."""

import os
import re
import warnings

# What numba takes. It starts no threads here, and prints no errors in colour.
TAKEN = {
    "NUMBA_NUM_THREADS": "[1-9][0-9]{0,4}",
    "NUMBA_COLOR_SCHEME": "no_color|dark_bg|light_bg|blue_bg|jupyter_nb",
}


def leave_out() -> None:
    """Remove variables with which numba fails from this process's environment, with a message."""
    for name, taken in TAKEN.items():
        given = os.environ.get(name)
        if given is not None and not re.fullmatch(taken, given):
            del os.environ[name]
            warnings.warn(f"{name} is {given!r}, which numba does not take: left out", stacklevel=3)
