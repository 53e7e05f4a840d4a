"""Every notebook runs from its first cell to its last, as somebody would who opens it.

Small sizes, in seconds each; `make notebooks` sets ASTRAY_NOTEBOOKS=full, which is minutes each.
"""

import os
from pathlib import Path

import pytest

from helpers.processes import environment

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SIZE = os.environ.get("ASTRAY_NOTEBOOKS", "small")
LONGEST = 300  # seconds of a notebook of full size, on two cores


def test_there_are_notebooks():
    assert {"find-the-goal", "a-world-of-your-own"} <= {path.stem for path in NOTEBOOKS}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_to_its_end(path, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    for name, value in environment(
        ASTRAY_NOTEBOOKS=SIZE, IPYTHONDIR=str(tmp_path), JUPYTER_PLATFORM_DIRS="1"
    ).items():
        monkeypatch.setenv(name, value)
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells), "outputs are not committed"
    client.NotebookClient(
        notebook,
        timeout=LONGEST,
        kernel_name="python3",
        allow_errors=False,
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    shown = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    assert any("image/png" in out.get("data", {}) for out in shown)
    if keep := os.environ.get("ASTRAY_NOTEBOOKS_OUT"):  # to be looked at
        nbformat.write(notebook, Path(keep) / path.name)
