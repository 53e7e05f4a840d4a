"""Compiled building blocks that the games share."""

import os
import re
import warnings

# Environment variables with which numba may fail to import, and what it takes.
TAKEN = {
    "NUMBA_NUM_THREADS": "[1-9][0-9]{0,4}",
    "NUMBA_COLOR_SCHEME": "no_color|dark_bg|light_bg|blue_bg|jupyter_nb",
}

for _name, _taken in TAKEN.items():
    _given = os.environ.get(_name)
    if _given is not None and not re.fullmatch(_taken, _given):
        del os.environ[_name]
        warnings.warn(f"{_name} is {_given!r}, which numba does not take: left out", stacklevel=2)
# Where numba cannot read its environment it warns with a traceback; the first line says it all.
with warnings.catch_warnings(record=True) as _said:
    import numba  # noqa: F401

for _warning in _said:
    warnings.warn(str(_warning.message).splitlines()[0], _warning.category, stacklevel=2)
