"""Other processes, that find what the tests find."""

import os
import sys


def environment(**changes: str) -> dict[str, str]:
    """This process's environment, with `changes`, for a Python that imports what this one does."""
    path = os.pathsep.join(filter(None, map(os.path.abspath, sys.path)))
    return os.environ | {"PYTHONPATH": path} | changes
