"""Notebooks are short, and run from top to bottom as they stand."""

import json
import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples").glob("*.ipynb"))
MOST = 40  # lines of code


def code(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_of_at_most_40_lines_of_code(path):
    lines = [line for cell in code(path) for line in cell.splitlines()]
    count = sum(bool(line.strip()) and not line.strip().startswith("#") for line in lines)
    assert 5 < count <= MOST


def test_a_kept_mouse_is_steered(capsys):
    (path,) = (one for one in NOTEBOOKS if one.stem == "steer")
    names = {}
    for number, cell in enumerate(code(path)):
        exec(compile(cell, f"{path.name}, cell {number}", "exec"), names)
    said = capsys.readouterr().out
    found = dict(re.findall(r"(as it is|steered down|random vector) +ends at ([+-][\d.]+)", said))
    ends = {name: float(height) for name, height in found.items()}
    assert ends["steered down"] < min(ends["as it is"], ends["random vector"]) - 0.5
    drawn = names["field_figures"].draw({"one": names["before"]})
    assert isinstance(drawn, Figure)
    assert (names["after"].arrows[:, 1] < names["before"].arrows[:, 1]).mean() > 0.5
