"""Each verb takes an agent with memory."""

import json
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from astray.analysis.trained import BY_ITSELF
from astray.experiments import hub
from astray.experiments import run as experiment_run
from astray.training import checkpoint
from astray.training.loop import train
from helpers.hub_server import WRITER, running
from helpers.thorough import thorough
from helpers.trainings import TINY

LEVELS = ("--levels", "1000000:1000004")


@pytest.fixture(scope="module")
def agent(tmp_path_factory):
    """The run folder of an agent with memory, trained for a moment."""
    folder = tmp_path_factory.mktemp("recurrent") / "seed-0"
    train(replace(TINY, network="mlp+gru", steps=512), folder, progress=False)
    return folder


def evaluated(astray, agent, out):
    rows = json.loads(astray("evaluate", agent, *LEVELS, "--json"))
    assert sum(row["mean"] for row in rows if row["policy"] == str(agent)) >= 1


def recorded(astray, agent, out):
    video = Path(astray("record", agent, "--pixels", "64", "--out", out / "a.gif").strip())
    assert video.stat().st_size > 1000


def assessed(astray, agent, out):
    assert json.loads(astray("agency", agent, *LEVELS, "--json"))["episodes"] == 4


def explained(astray, agent, out):
    page = Path(astray("explain", agent, "--num-levels", "10", "--out", out).strip())
    assert BY_ITSELF in page.read_text()


def exported_lab(astray, agent, out):
    told = astray("lab", agent, "--export", out / "site", fails=True)  # a table forgets
    assert "has a memory: there is no table of all that it may see" in told
    assert not (out / "site").exists()


def exported_data(astray, agent, out):
    folder = Path(astray("export", agent, *LEVELS, "--out", out / "data").strip())
    table = pl.read_parquet(next(folder.rglob("*.parquet")))
    played = json.loads(astray("evaluate", agent, *LEVELS, "--json", "--out", out / "e.parquet"))
    assert played and len(table) > 0


def kept(astray, agent, out):
    folder = Path(astray("keep", agent, "--as", "elephant", "--out", out).strip())
    assert "mlp+gru" in next(folder.rglob("*.md")).read_text()


def pushed(astray, agent, out):
    from huggingface_hub import HfApi

    with running() as server, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_TOKEN", WRITER)
        patch.setattr(hub, "_api", lambda _: HfApi(endpoint=server.address))
        astray("push", agent, "ada/elephant")
        repository = server.repositories["ada/elephant"]
        assert b"mlp+gru" in repository.commits[repository.at("main")]["README.md"]


def compared(astray, agent, out):
    words = ("compare", agent, "walk:cheese", *LEVELS, "--out", out)
    assert "walk to cheese" in Path(astray(*words).strip()).read_text()


def audited(astray, agent, out):
    page = Path(astray("audit", agent, "--num-levels", "4", "--out", out).strip())
    assert "seed-0 pursue cheese or corner?" in page.read_text("utf-8")


def distilled(astray, agent, out):
    more = ("--observation", "symbolic", "--network", "mlp+lstm", "--steps", "16384")
    run = Path(astray("distil", agent, *more, "--out", out).strip()).parents[1]
    assert checkpoint.read_config(run).network == "mlp+lstm"


def swept(astray, agent, out):
    config = checkpoint.read_config(agent)
    few = [f"--{name}={getattr(config, name)}" for name in ("steps", "minibatches", "width")]
    axes = ("--set", "network=mlp,mlp+gru", "--set", "num_envs=16", "--num-steps", "16")
    page = astray(
        "sweep", "maze", "corner-small", *axes, *few, "--num-test-levels", "20", "--out", out
    )
    assert "mlp+gru" in Path(page.strip()).read_text()


VERBS = (
    evaluated, recorded, assessed, exported_lab, exported_data, compared, audited,
    *thorough(explained, kept, pushed, distilled, swept),
)  # fmt: skip


@pytest.mark.filterwarnings("ignore:Use 'content=<...>':DeprecationWarning")  # of huggingface_hub
@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_a_verb_takes_an_agent_with_memory(
    verb, astray, agent, tmp_path, coarse, monkeypatch, request
):
    if verb in (compared, audited):  # `recorded` has a video
        request.getfixturevalue("undrawn")

    def here(todo, *_):
        for run, config in todo.items():
            train(config, run, progress=False)

    monkeypatch.setattr(experiment_run, "train_all", here)
    verb(astray, agent, tmp_path)
