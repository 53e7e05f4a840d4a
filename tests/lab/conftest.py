"""Labs that several tests look at."""

import pytest

from astray.lab.export import export
from astray.lab.serving import make_lab
from helpers.browsed import browser, folder_served


@pytest.fixture(scope="session")
def chrome():
    with browser() as found:
        yield found


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """The folder of a lab without Python, with few levels."""
    folder = tmp_path_factory.mktemp("lab") / "site"
    export(make_lab("maze-corner", {}), folder, levels=8)
    return folder


@pytest.fixture(scope="session")
def static(exported):
    with folder_served(exported) as address:
        yield address
