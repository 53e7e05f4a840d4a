"""The notebook that steers an agent is short, and what it shows is so."""

import json
import re
from pathlib import Path

from matplotlib.figure import Figure

NOTEBOOK = Path(__file__).parents[2] / "examples/notebooks/steer.ipynb"
MOST = 40  # lines of code


def code(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    steering = (cell for cell in cells if cell["id"] != "install")
    return ["".join(cell["source"]) for cell in steering if cell["cell_type"] == "code"]


def test_it_is_of_at_most_40_lines_of_code():
    lines = [line for cell in code(NOTEBOOK) for line in cell.splitlines()]
    count = sum(bool(line.strip()) and not line.strip().startswith("#") for line in lines)
    assert 5 < count <= MOST


def test_a_kept_mouse_is_steered(capsys):
    names = {}
    for number, cell in enumerate(code(NOTEBOOK)):
        cell = cell.replace("200_500", "200_100").replace("range(2000)", "range(500)")  # levels
        exec(compile(cell, f"{NOTEBOOK.name}, cell {number}", "exec"), names)
    said = capsys.readouterr().out
    found = dict(re.findall(r"(as it is|steered down|random vector) +ends at ([+-][\d.]+)", said))
    ends = {name: float(height) for name, height in found.items()}
    assert ends["steered down"] < min(ends["as it is"], ends["random vector"]) - 0.5
    drawn = names["field_figures"].draw({"one": names["before"]})
    assert isinstance(drawn, Figure)
    assert (names["after"].arrows[:, 1] < names["before"].arrows[:, 1]).mean() > 0.5
