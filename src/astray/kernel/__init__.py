"""Compiled building blocks that the games share."""

import warnings

from astray.kernel.variables import leave_out

leave_out()
# Where numba cannot read its environment it warns with a traceback; the first line says it all.
with warnings.catch_warnings(record=True) as _said:
    import numba  # noqa: F401

for _warning in _said:
    warnings.warn(str(_warning.message).splitlines()[0], _warning.category, stacklevel=2)
