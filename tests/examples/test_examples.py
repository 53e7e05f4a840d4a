"""A stranger's package: installed beside astray, found by its name, tested by its own tests."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "open-room"


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """The environment of a process that finds the example installed, in a folder of its own."""
    folder = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps",
               "--no-build-isolation", "--target", str(folder), str(EXAMPLE)]  # fmt: skip
    subprocess.run(command, check=True)
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths)}


def run(environment, folder, *words):
    done = subprocess.run(
        [sys.executable, *words], env=environment, cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_its_own_tests_pass(beside, tmp_path):
    run(beside, tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLE / "tests"))


VERBS = """
import sys
from astray.cli import main
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
    said = run(beside, tmp_path, "-W", "ignore", "-c", VERBS, *words)
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


def test_an_edit_of_its_rules_is_seen_by_the_next_process(beside, tmp_path):
    assert run(beside, tmp_path, "-c", EDITED).split() == ["0.0", "0.0"]
    assert run(beside, tmp_path, "-c", EDITED).split() == ["0.5", "0.5"]


def test_the_page_on_extending_runs_as_it_stands(tmp_path):
    run_page("extending", 8, tmp_path)
    assert '"update/size"' in (tmp_path / "mouse" / "metrics.jsonl").read_text("utf-8")


def test_the_page_on_worlds_runs_as_it_stands(tmp_path):
    said = run_page("worlds", 7, tmp_path)
    assert "right misgeneralizes: it pursues end, not bell" in said
    assert (tmp_path / "reports" / "the-bell-smoke" / "report.html").exists(), said


def run_page(name, count, folder):
    """Run the Python code of a page of the documentation; what it prints."""
    page = (EXAMPLE.parents[1] / "docs" / f"{name}.md").read_text("utf-8")
    blocks = [part.partition("```")[0] for part in page.split("```python\n")[1:]]
    assert len(blocks) == count
    (folder / "page.py").write_text("\n".join(blocks), "utf-8")
    return run(os.environ | {}, folder, "page.py")
