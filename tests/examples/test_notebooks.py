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
# In small, `test_steer` runs all cells of the one that steers.
RUN = [path for path in NOTEBOOKS if SIZE == "full" or path.stem != "steer"]
LONGEST = 300  # seconds of a notebook of full size, on two cores


def test_there_are_notebooks():
    assert {"find-the-goal", "a-world-of-your-own"} <= {path.stem for path in NOTEBOOKS}


def read(path):
    return pytest.importorskip("nbformat").read(path, as_version=4)


def test_notebooks_are_valid_and_committed_without_outputs():
    for path in NOTEBOOKS:
        pytest.importorskip("nbformat").validate(read(path))
        assert not any(cell.get("outputs") for cell in read(path).cells), path


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("path", RUN, ids=lambda path: path.stem)
def test_a_notebook_runs_to_its_end(path, tmp_path, monkeypatch):
    client = pytest.importorskip("nbclient")
    for name, value in environment(
        ASTRAY_NOTEBOOKS=SIZE, IPYTHONDIR=str(tmp_path), JUPYTER_PLATFORM_DIRS="1"
    ).items():
        monkeypatch.setenv(name, value)
    notebook = read(path)
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
        pytest.importorskip("nbformat").write(notebook, Path(keep) / path.name)
