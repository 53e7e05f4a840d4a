"""What attempts are made with: small agents, levels, tables and archives, as astray makes them.

Everything is made in forks, so that the process that is forked for each attempt has no threads of
polars or torch, which a fork would not have.
"""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import sys
import traceback
import zipfile
from collections.abc import Callable
from pathlib import Path

# All settings of the command line that make a training take a moment, in the run that is made.
TINY = (
    "maze", "corner-small", "--validation", "anywhere-small", "--num-envs", "16", "--num-steps",
    "16", "--minibatches", "4", "--steps", "1024", "--validation-every", "1", "--checkpoint-every",
    "2", "--width", "16", "--set", "world=5", "largest=5", "time_limit=20",
)  # fmt: skip
EXPERIMENT = '''
"""An experiment on an agent that comes with astray: nothing is trained."""

from astray.training import folders
from astray.analysis.runs import shift_of
from astray.experiments.outcomes import settings
from astray.report.findings import Findings, Table
from astray.experiments.spec import Experiment, Plan, tests_of
from astray.training.checkpoint import read_config

MOUSE = read_config(folders.find("maze-corner"))


def find(work):
    return Findings(answer="It was played.", claims=[], settings=settings(work.plan),
                    tables=[Table("episodes", "All episodes", work.episodes)])


PLAN = Plan(agents={"mouse": MOUSE}, published={"mouse": "maze-corner"}, levels=4, differences="",
            tests=tests_of("maze", shift_of(MOUSE)))
EXPERIMENT = Experiment(title="A mouse", reproduces="nothing", question="Where to?",
                        sizes={"smoke": PLAN}, find=find)
'''
RESULTS = "seed,steps,coin_collected,inv_coin_collected,died,timed_out\n1,20,1,0,0,0\n2,9,0,0,1,0\n"


def make(made: Path) -> None:
    """Make everything in `made` that is not there yet; what fails ends the attack."""
    made.mkdir(exist_ok=True)
    for name, maker in MAKERS.items():
        mark = made / f"{name}.made"
        if not mark.exists():
            _in_a_fork(name, made, maker)
            mark.touch()


def _in_a_fork(name: str, made: Path, maker: Callable[[Path], None]) -> None:
    sys.stdout.flush()
    child = os.fork()
    if not child:
        try:
            os.chdir(made)
            number = os.open(made.parent / "made.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(number, 1)
            maker(made)
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    if os.waitpid(child, 0)[1]:
        raise RuntimeError(f"what is attacked with cannot be made: {name}")


def _command(*words: object) -> None:
    from astray import cli

    sys.argv = ["astray", *map(str, words)]
    cli.main()


def warm(games: tuple[str, ...] = ("maze", "coinrun", "keys")) -> None:
    """Load the compiled code of all games, or compile it."""
    import numpy as np

    from astray.envs.vector import GameVectorEnv

    for game in games:
        for observation in ("symbolic", "image"):
            env = GameVectorEnv(game, SMALLEST[game], 2, observation=observation)
            env.reset(seed=0)
            env.step(np.zeros(2, int))
            env.close()


SMALLEST = {"maze": "corner-small", "coinrun": "coin-end", "keys": "many-chests-small"}


def _code(made: Path) -> None:
    warm()


def _run(made: Path) -> None:
    _command("train", *TINY, "--out", made / "runs")
    shutil.move(made / "runs" / "seed-0", made / "run")
    half = shutil.copytree(made / "run", made / "half")  # as if it was killed at half its steps
    shutil.rmtree(half / "checkpoints" / "1024")


def _levels(made: Path) -> None:
    import numpy as np

    from astray.envs.states import save_states
    from astray.envs.vector import GameVectorEnv
    from astray.level import Level

    for game, variant in SMALLEST.items():
        env = GameVectorEnv(game, variant, 2, observation="symbolic")
        env.reset(seed=1)
        env.step(np.zeros(2, int))
        save_states(made / f"{game}.npz", game, env.get_state())
        env.reset(options={"level": 3})
        level = Level.of(env.game, env.variant, env.states[0])
        (made / f"{game}.txt").write_text(f"{level}\n")
        (made / f"{game}.json").write_text(json.dumps(level.to_json()))
    (made / "actions.txt").write_text("up right 7 7 stay\n")
    (made / "results.csv").write_text(RESULTS)
    (made / "experiment.py").write_text(EXPERIMENT)


def _others(made: Path) -> None:
    from attack.pickles import Payload
    from helpers.foreign import clarity, joblib_bytes, reference, saved

    weights, _ = reference((4, 4, 4))
    (made / "agent.pth").write_bytes(saved({"model_state_dict": weights}))
    data, _ = clarity()
    (made / "agent.jd").write_bytes(joblib_bytes(data))
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("procgen/data/assets/kenney/one.png", b"no picture")
    (made / "pictures.whl").write_bytes(file.getvalue())
    (made / "hostile.pkl").write_bytes(pickle.dumps(Payload("touch", str(made / "never"))))


def _imported(made: Path) -> None:
    os.environ["ASTRAY_AGENTS"] = str(made / "agents")
    _command(
        "import",
        made / "agent.pth",
        "--as",
        "other",
        "--game",
        "maze",
        "--variant",
        "anywhere",
        "--art",
        "own",
    )


def _dataset(made: Path) -> None:
    _command("export", made / "run", "--levels", "0:4", "--out", made / "dataset")


def _report(made: Path) -> None:
    _command("reproduce", made / "experiment.py", "--out", made / "reports", "--workers", "1")


def sweep_words(folder: Path) -> tuple[object, ...]:
    """The command of the sweep that is made."""
    tiny = TINY[: TINY.index("--width")]
    return (
        "sweep",
        *tiny,
        "--set",
        "width=8,16",
        "--num-test-levels",
        "4",
        "--workers",
        "1",
        "--out",
        folder,
    )


def _sweep(made: Path) -> None:
    """The sweep; its agents are trained here, as a process for each takes seconds to begin."""
    from dataclasses import replace

    from astray.experiments.run import run_folder
    from astray.training.checkpoint import read_config
    from astray.training.loop import train

    base = replace(read_config(made / "run"), knobs={})
    for width in (8, 16):
        config = replace(base, width=width)
        train(config, run_folder(made / "sweep", config), progress=False)
    _command(*sweep_words(made / "sweep"))


def _alone(made: Path) -> None:
    from attack.together import make_alone

    make_alone(made)


MAKERS: dict[str, Callable[[Path], None]] = {
    "compiled code": _code, "a run": _run, "levels": _levels, "files of others": _others,
    "an imported agent": _imported, "a data set": _dataset, "a report": _report,
    "a sweep": _sweep, "what is undisturbed": _alone,
}  # fmt: skip
