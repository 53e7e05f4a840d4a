"""Every notebook runs from its first cell to its last, as somebody would who opens it.

Small sizes, in seconds each; `make notebooks` sets ASTRAY_NOTEBOOKS=full, which is minutes each,
and saves the notebooks with their outputs in ASTRAY_NOTEBOOKS_OUT.
"""

import hashlib
import os
from pathlib import Path

import pytest

from helpers.processes import environment

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SIZE = os.environ.get("ASTRAY_NOTEBOOKS", "small")
# In small, `test_steer` runs all cells of the one that steers.
RUN = [path for path in NOTEBOOKS if SIZE == "full" or path.stem != "steer"]
LONGEST = 300  # seconds of a cell of full size, on two cores
LIVE = "application/vnd.jupyter.widget-view+json"  # an output that needs a running kernel
INSTALL = "install"  # the id of the cell that installs astray


def test_there_are_notebooks():
    assert {"find-the-goal", "a-world-of-your-own"} <= {path.stem for path in NOTEBOOKS}


def read(path):
    return pytest.importorskip("nbformat").read(path, as_version=4)


def codes(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def digest(notebook):
    """The digest of all code, which the metadata of a notebook that was run holds."""
    text = "\n\n".join(cell.source for cell in codes(notebook))
    return hashlib.sha256(text.encode()).hexdigest()


def shows_picture(notebook):
    outputs = [out for cell in codes(notebook) for out in cell.outputs]
    return any("image/png" in out.get("data", {}) for out in outputs)


def save(notebook, metadata, path):
    """Write a notebook that was run, without notes on compiling, with the digest of its code."""
    for cell in codes(notebook):
        cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
        for out in cell.outputs:
            out.get("data", {}).pop(LIVE, None)
    notebook.metadata = {**metadata, "code_digest": digest(notebook)}
    pytest.importorskip("nbformat").write(notebook, path)


def test_all_notebooks_are_valid_and_install_astray_by_the_same_cell():
    for path in NOTEBOOKS:
        pytest.importorskip("nbformat").validate(read(path))
    cells = [cell for path in NOTEBOOKS for cell in read(path).cells if cell.id == INSTALL]
    assert len(cells) == len(NOTEBOOKS) and len({cell.source for cell in cells}) == 1


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_saved_with_the_outputs_of_its_code(path):
    notebook = read(path)
    counts = [cell.execution_count for cell in codes(notebook)]
    assert counts == [*range(1, len(counts) + 1)], "`make notebooks` saves the outputs"
    assert notebook.metadata["code_digest"] == digest(notebook), "`make notebooks` runs it anew"
    assert shows_picture(notebook) and "PosixPath" not in path.read_text()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.thorough
@pytest.mark.parametrize("path", RUN, ids=lambda path: path.stem)
def test_a_notebook_runs_to_its_end(path, tmp_path, monkeypatch):
    client = pytest.importorskip("nbclient")
    settings = {"ASTRAY_NOTEBOOKS": SIZE, "IPYTHONDIR": str(tmp_path), "JUPYTER_PLATFORM_DIRS": "1"}
    settings["MPLBACKEND"] = ""  # which EnvPool sets for all that follows, where it is imported
    for name, value in environment(**settings).items():
        monkeypatch.setenv(name, value)
    notebook = read(path)
    metadata = dict(notebook.metadata)
    client.NotebookClient(
        notebook,
        timeout=LONGEST,
        kernel_name="python3",
        allow_errors=False,
        record_timing=False,
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    assert shows_picture(notebook)
    if folder := os.environ.get("ASTRAY_NOTEBOOKS_OUT"):
        save(notebook, metadata, Path(folder) / path.name)
