"""How much was tried is told at the end of each file."""

import json
import os

import pytest

from helpers import anything


@pytest.fixture(scope="module", autouse=True)
def _count():
    anything.COUNTS.clear()
    yield
    if log := os.environ.get("ASTRAY_FUZZ_LOG"):
        with open(log, "a") as file:
            file.write(json.dumps(anything.COUNTS) + "\n")
