"""A stranger's package: installed beside astray, found by its name, tested by its own tests."""

import ast
import inspect
import os
import re
import textwrap
import zipfile
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from helpers.processes import begin
from helpers.thorough import thorough

EXAMPLE = Path(__file__).parents[2] / "examples" / "open-room"


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """The environment of a process that finds the example installed, in a folder of its own."""
    folder = tmp_path_factory.mktemp("installed")
    builder = pytest.importorskip("hatchling.builders.wheel").WheelBuilder(str(EXAMPLE))
    (wheel,) = builder.build(directory=str(folder), versions=["standard"])
    with zipfile.ZipFile(wheel) as files:  # all that pip would do, in two more processes
        files.extractall(folder)
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths)}


def run(program, folder, *words, env=None):
    code, out, err = begin(program, folder, *words, env=env or os.environ).ended()
    assert code == 0, out + err
    return out


PYTEST = """
import sys, pytest
if __name__ == "__main__":  # which a training's process does not do again
    sys.exit(pytest.main(sys.argv[1:]))
"""


@pytest.mark.thorough  # `test_verbs_know_it` trains an agent in it
def test_its_own_tests_pass(beside, tmp_path):
    words = ("-q", "-p", "no:cacheprovider", str(EXAMPLE / "tests"))
    run(PYTEST, tmp_path, *words, env=beside)


VERBS = """
import sys, warnings
from astray.cli import main
warnings.simplefilter("ignore")
for words in sys.argv[1:]:
    sys.argv = ["astray", *words.split()]
    main()
    print("done")
"""


def test_verbs_know_it(beside, tmp_path):
    words = (
        "list",
        "train open-room corner --network open_room.learning:Tanh --steps 512 --num-envs 8 "
        "--num-steps 16 --minibatches 2",
        "evaluate runs/open-room-corner/seed-0 --levels 0:50 --json",
    )
    said = run(VERBS, tmp_path, *words, env=beside)
    listed, _, assessed, _ = said.split("done\n")
    assert (
        "open-room" in listed
        and '"runs/open-room-corner/seed-0"' in assessed
        and '"random"' in assessed
    )


EDITED = """
import pathlib, sys
import numpy as np
from astray.envs.vector import GameVectorEnv
from open_room import game
env = GameVectorEnv(game.GAME, "corner", 1, observation="symbolic")
env.reset(seed=0)
print(env.step(np.array([0]))[1][0], env.step(np.array([3]))[1][0])
source = pathlib.Path(game.__file__)
source.write_text(source.read_text().replace("return 0.0, False", "return 0.5, False"))
"""


@pytest.mark.thorough  # `test_an_edit_is_another_digest_once_it_is_loaded`, by which code is kept
def test_an_edit_of_its_rules_is_seen_by_the_next_process(beside, tmp_path):
    assert run(EDITED, tmp_path, env=beside).split() == ["0.0", "0.0"]
    assert run(EDITED, tmp_path, env=beside).split() == ["0.5", "0.5"]


def test_the_page_on_extending_says_how_long_a_game_is():
    lines = (EXAMPLE / "src/open_room/game.py").read_text().count("\n")
    page = (EXAMPLE.parents[1] / "docs/extending.md").read_text()
    assert f"a game of {lines} lines" in page


def test_the_page_on_extending_runs_as_it_stands(tmp_path):
    run_page("extending", 9, tmp_path)
    assert '"update/size"' in (tmp_path / "mouse" / "metrics.jsonl").read_text("utf-8")


@pytest.mark.parametrize("page", sorted((EXAMPLE.parents[1] / "docs").glob("*.md")), ids=str)
def test_code_of_a_page_imports_and_calls_what_there_is(page):
    names: dict[str, Any] = {}
    for node in ast.walk(ast.parse("\n".join(code_of(page.read_text("utf-8"))))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            if ast.unparse(node).split()[1].split(".")[0] == "astray":
                exec(ast.unparse(node), names)
        elif isinstance(node, ast.Call) and callable(called := named(node.func, names)):
            given = [one for one in node.args if not isinstance(one, ast.Starred)]
            words = {one.arg: one.value for one in node.keywords if one.arg}
            inspect.signature(called).bind_partial(*given, **words)


def named(node, names):
    """Return the value of a dotted name, or None if a page does not have it from astray."""
    if isinstance(node, ast.Attribute):
        return (whole := named(node.value, names)) and getattr(whole, node.attr)
    return names.get(getattr(node, "id", ""))


@pytest.mark.thorough  # the test before has its names, and `tests/analysis` a World
def test_the_page_on_worlds_runs_as_it_stands_with_fewer_steps(tmp_path):
    def fewer(text):  # a rollout of 64, in the place of two of 2,048, for each of three agents
        text = text.replace("learn(4_000)", "learn(1)")
        return re.sub(r'(PPO\("MlpPolicy", .*?device="cpu")', r"\1, n_steps=64", text)

    said = run_page("worlds", 9, tmp_path, fewer)
    assert "right misgeneralizes: it pursues end, not bell" in said
    assert (tmp_path / "reports" / "the-bell-smoke" / "report.html").exists(), said


@pytest.mark.parametrize(
    ("page", "count", "written"),
    [
        ("first-mouse", 3, "outcomes.png"),
        *thorough(("first-world", 4, "robots.png"), ("first-look-inside", 4, "cheese.png")),
    ],
)
def test_a_tutorial_runs_as_it_stands_with_fewer_steps(page, count, written, tmp_path):
    def fewer(text):
        text = re.sub(r"STEPS = [\d_]+", "STEPS = 512", text)
        return re.sub(r"range\(200_000, 200_\d+\)", "range(200_000, 200_050)", text)

    run_page(page, count, tmp_path, fewer)
    assert (tmp_path / written).exists()


LIBRARIES = ("stable_baselines3", "torchrl", "pufferlib")


@pytest.mark.thorough  # `test_code_of_a_page_imports_and_calls_what_there_is`, `test_friends`
def test_the_page_for_those_of_other_libraries_runs_where_they_are(tmp_path):
    def installed(page):
        kept, *blocks = page.split("```python\n")
        for block in blocks:
            code = block.partition("```")[0]
            missing = [one for one in LIBRARIES if one in code and not find_spec(one)]
            kept += block if missing else "```python\n" + block
        return kept

    there = 1 + sum(find_spec(one) is not None for one in LIBRARIES)
    said = run_page("coming-from", there, tmp_path, installed)
    assert said.count("goal misgenerali") == there


def code_of(page):
    """The blocks of Python in the text of a page."""
    return [textwrap.dedent(part.partition("```")[0]) for part in page.split("```python\n")[1:]]


def run_page(name, count, folder, change=lambda page: page):
    """Run the Python code of a page of the documentation; what it prints."""
    page = change((EXAMPLE.parents[1] / "docs" / f"{name}.md").read_text("utf-8"))
    blocks = code_of(page)
    assert len(blocks) == count
    return run("\n".join(blocks), folder)


def test_the_figures_of_results_are_of_the_tables_on_their_pages():
    path = EXAMPLE.parents[1] / "docs" / "figures.py"
    spec = spec_from_file_location("figures", path)
    figures = module_from_spec(spec)
    spec.loader.exec_module(figures)
    for name, draw in figures.FIGURES.items():
        with Image.open(path.parent / f"figure-{name}.png") as image:
            data, _ = draw()
            assert image.text[figures.NUMBERS] == data.write_csv(), f"{name}: draw it anew"
