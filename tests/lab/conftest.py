"""Labs and agents that several tests look at."""

import json
from dataclasses import replace

import pytest
import torch

from astray.agents.policy import weights
from astray.lab.export import export
from helpers.browsed import folder_served, lab_served, opened, usual_lab


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """The folder of a lab without Python, with few levels."""
    folder = tmp_path_factory.mktemp("lab") / "site"
    export(usual_lab(), folder, levels=8, games={"pottery": "corner"})
    return folder


@pytest.fixture(scope="session")
def static(exported):
    with folder_served(exported) as address:
        yield address


@pytest.fixture(scope="module")
def served():
    with lab_served(usual_lab()) as address:
        yield address


@pytest.fixture(scope="module")
def window(chrome, served):
    """A window to load pages in, and what they wrote to its console."""
    with opened(chrome, served) as both:
        yield both


@pytest.fixture(scope="module")
def page(chrome, static):
    """The page without Python, opened."""
    with opened(chrome, static) as (page, told):
        yield page
        assert not told  # on the console


@pytest.fixture
def untrained():
    """Writes an agent of Maze that has learned nothing to a run folder, and tells its path."""

    def write(folder, architecture, **settings):
        torch.manual_seed(0)
        sizes = {"network": architecture.name, "scale": architecture.scale}
        settings = {**sizes, "width": architecture.width, **settings}
        config = replace(usual_lab().agents.open("maze-corner")[1], **settings)
        path = folder / "checkpoints" / "1" / "agent.safetensors"
        path.parent.mkdir(parents=True)
        path.write_bytes(weights(architecture.build(), architecture, config.game))
        (folder / "config.json").write_text(json.dumps({"config": config.to_json()}))
        return path

    return write
