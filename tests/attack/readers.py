"""Class 4: every file that astray reads, ruined in every way."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack.core import Attempt, Place
from attack.files import CHANGED, PLACED, ruin
from attack.material import SMALLEST, TINY, sweep_words

Use = Callable[[Place], Any]


def attempts() -> Iterator[Attempt]:
    for reader in READERS:
        for how in (*CHANGED, *PLACED):
            if reader in SLOW and how not in FEW:
                continue
            act = functools.partial(_read, reader, how)
            yield Attempt(4, f"{reader}: {how}", act, "any", seconds=40)


def _read(reader: str, how: str, place: Place) -> Any:
    path, use = READERS[reader](place)
    ruin(path, how)
    place.watch()
    return use(place)


def _run(file: str, *words: str) -> Callable[[Place], tuple[Path, Use]]:
    """A file of a run's folder, and a command that reads it."""

    def make(place: Place) -> tuple[Path, Use]:
        return place.copy("run") / file, lambda place: place.astray(*words)

    return make


def _resumed(file: str) -> Callable[[Place], tuple[Path, Use]]:
    """A file of a run that is gone on with."""

    def make(place: Place) -> tuple[Path, Use]:
        there = place.copy("half", "runs/seed-0")
        return there / file, lambda place: place.astray("train", *TINY, "--out", "runs")

    return make


def _level(name: str) -> Callable[[Place], tuple[Path, Use]]:
    game = name.partition(".")[0]

    def use(place: Place) -> Any:
        return place.astray(
            "replay",
            game,
            SMALLEST[game],
            "--level-file",
            name,
            "--actions",
            place.made / "actions.txt",
        )

    return lambda place: (place.copy(name), use)


def _command(name: str, *words: str) -> Callable[[Place], tuple[Path, Use]]:
    """A file that a command is given."""
    return lambda place: (place.copy(name), lambda place: place.astray(*words))


def _called(name: str, use: Callable[[Path], Any]) -> Callable[[Place], tuple[Path, Use]]:
    """A file that a function reads: given the file, or the folder that was copied."""
    top = name.partition("/")[0]
    return lambda place: (
        place.copy(top) / name.partition("/")[2] if "/" in name else place.copy(name),
        lambda place: use(place.work / top),
    )


def _states(path: Path) -> Any:
    import numpy as np

    from astray.envs.states import load_states
    from astray.envs.vector import GameVectorEnv

    env = GameVectorEnv("maze", SMALLEST["maze"], 2, observation="symbolic")
    env.set_state(load_states(path, "maze"))
    return env.step(np.zeros(2, int))


def _results(path: Path) -> Any:
    from astray.published.results import read_results

    return read_results(path)


def _trajectories(folder: Path) -> Any:
    from astray.analysis.dataset import read_trajectories

    return list(read_trajectories(folder))


def _index(folder: Path) -> Any:
    from astray.report import page as report

    report.of_claims(folder / "experiment-smoke")
    return report.write_index(folder)


def _card(folder: Path) -> Any:
    from astray.published.imported import write_card

    write_card(folder / "other", "other")


def _teacher(folder: Path) -> Any:
    from dataclasses import replace

    from astray.training.config import PRESETS
    from astray.training.loop import train

    config = replace(
        PRESETS["small"],
        variant="corner-small",
        knobs={"world": 5, "largest": 5},
        num_envs=4,
        num_steps=4,
        minibatches=1,
        steps=32,
        width=4,
        teacher="one",
    )
    return train(config, folder / "student", progress=False)


def _taught(place: Place) -> tuple[Path, Use]:
    path = place.work / "there" / "student" / "teacher.safetensors"
    path.parent.mkdir(parents=True)
    path.write_bytes(next((place.made / "run").glob("checkpoints/1024/agent*")).read_bytes())
    return path, lambda place: _teacher(place.work / "there")


def _reproduced(file: str) -> Callable[[Place], tuple[Path, Use]]:
    """A file of a report that is gone on with."""

    def make(place: Place) -> tuple[Path, Use]:
        there = place.copy("reports") / "experiment-smoke" / file
        words = ("reproduce", place.made / "experiment.py", "--workers", "1")
        return there, lambda place: place.astray(*words)

    return make


def _swept(file: str) -> Callable[[Place], tuple[Path, Use]]:
    def make(place: Place) -> tuple[Path, Use]:
        there = place.copy("sweep")
        path = next(there.glob(file))
        return path, lambda place: place.astray(*sweep_words(there))

    return make


def _in_lab(place: Place) -> tuple[Path, Use]:
    words = ("lab", "maze-corner", "--level-file", "maze.txt", "--export", "page",
             "--num-levels", "1")  # fmt: skip
    return place.copy("maze.txt"), lambda place: place.astray(*words)


def _imported(file: str) -> Callable[[Place], tuple[Path, Use]]:
    """A file of an imported agent, which every list of agents reads."""

    def make(place: Place) -> tuple[Path, Use]:
        import os

        os.environ["ASTRAY_AGENTS"] = str(place.copy("agents"))
        words = ("evaluate", "other", "--levels", "0:2")
        return place.work / "agents" / "other" / file, lambda place: place.astray(*words)

    return make


def _listed(place: Place) -> tuple[Path, Use]:
    path, _ = _imported("config.json")(place)
    return path, lambda place: place.astray("list", "--json")


# Readers that take seconds where what they read can be read; and what is tried of them.
SLOW = (
    "the metrics of a run that is kept", "a drawing in the lab", "an experiment", "a teacher",
    "the plan of a report", "the episodes of a report", "what a sweep says",
    "the episodes of a sweep", "the settings of a listed agent",
)  # fmt: skip
FEW = ("empty", "half", "zeros", "null", "brackets without end", "no text",
       "a byte turned in the middle", "a folder", "a pipe", "a closed file",
       "a link to nothing", "a device without end")  # fmt: skip
PLAY = ("--levels", "0:2")
IMPORT = ("--as", "mine", "--game", "maze", "--variant", "anywhere", "--art", "own")
WEIGHTS = "checkpoints/1024/agent.safetensors"
READERS: dict[str, Callable[[Place], tuple[Path, Use]]] = {
    "the settings of a run": _run("config.json", "evaluate", "run", *PLAY),
    "the network of a run": _run(WEIGHTS, "evaluate", "run", *PLAY),
    "the metrics of a run that is kept": _run(
        "metrics.jsonl", "keep", "run", "--as", "kept", "--out", "to"
    ),
    "the settings of a training": _resumed("config.json"),
    "the metrics of a training": _resumed("metrics.jsonl"),
    "the network of a training": _resumed("checkpoints/512/agent.safetensors"),
    "the rest of a training": _resumed("checkpoints/512/trainer.safetensors"),
    "a drawing of maze": _level("maze.txt"),
    "a level of maze": _level("maze.json"),
    "a drawing of coinrun": _level("coinrun.txt"),
    "a level of keys": _level("keys.json"),
    "a drawing in the lab": _in_lab,
    "actions": _command(
        "actions.txt", "replay", "maze", "corner-small", "--level", "0", "--actions", "actions.txt"
    ),
    "an agent of torch": _command("agent.pth", "import", "agent.pth", *IMPORT),
    "an agent of joblib": _command("agent.jd", "import", "agent.jd", *IMPORT),
    "a wheel": _command("pictures.whl", "art", "import", "pictures.whl"),
    "an experiment": _command("experiment.py", "reproduce", "experiment.py", "--workers", "1"),
    "states": _called("maze.npz", _states),
    "a table of results": _called("results.csv", _results),
    "what a data set says": _called("dataset/dataset.json", _trajectories),
    "the steps of a data set": _called("dataset/steps/00000.parquet", _trajectories),
    "the findings of a report": _called("reports/experiment-smoke/findings.json", _index),
    "where an agent is from": _called("agents/other/origin.json", _card),
    "a teacher": _taught,
    "the plan of a report": _reproduced("plan.json"),
    "the episodes of a report": _reproduced("computed/episodes.parquet"),
    "what a sweep says": _swept("sweep.json"),
    "the episodes of a sweep": _swept("computed/*.parquet"),
    "the settings of an imported agent": _imported("config.json"),
    "the network of an imported agent": _imported("checkpoints/0/agent.safetensors"),
    "the settings of a listed agent": _listed,
}
