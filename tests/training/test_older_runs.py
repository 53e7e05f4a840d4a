"""Run folders whose settings have older names are read, and trained on."""

import json
import shutil
from dataclasses import replace

import pytest
import torch

from astray.agents.policy import Architecture, load, weights
from astray.analysis.runs import open_run
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.loop import train
from astray.training.older import RENAMED
from astray.validation import OldName
from helpers.trainings import TINY, digest


def in_older_words(data):
    """Settings as versions wrote them that had other names."""
    data = data | {old: data[new] for old, new in RENAMED.items()} | {"network": "small"}
    return {name: value for name, value in data.items() if name not in RENAMED.values()}


def test_settings_in_older_words_are_those_of_today():
    with pytest.warns(OldName) as notes:
        assert Config.from_json(in_older_words(TINY.to_json())) == TINY
    assert len(notes) == len(RENAMED)
    assert any("says 'share'; this is now 'fraction'" in str(note.message) for note in notes)
    with pytest.raises(ValueError, match="no setting 'environment'"):
        Config.from_json(TINY.to_json() | {"environment": 3})


def test_a_knob_that_came_later_was_as_it_is_by_default():
    mixed = replace(TINY, knobs=TINY.knobs | {"shift_probability": 0.1}, validation=None)
    data = json.loads(json.dumps(mixed.to_json()))
    for variant in (data["training_variant"], data["training_variant"]["shifted"]):
        del variant["dish_planes"]
    assert Config.from_json(data) == mixed
    data["training_variant"]["shifted"]["window"] = 3
    with pytest.raises(ValueError, match="its maze corner-small is not that of this version"):
        Config.from_json(data)


@pytest.mark.filterwarnings("ignore:a file of settings says:astray.validation.OldName")
def test_an_older_run_is_opened_and_goes_on_as_it_would_have(tmp_path):
    config = replace(TINY, validation=None, checkpoint_every=1, steps=4 * TINY.batch)
    run = tmp_path / "run"
    train(config, run, progress=False)
    whole = digest(run)
    shutil.rmtree(checkpoint.latest(run))
    settings = json.loads((run / "config.json").read_text())
    settings["config"] = in_older_words(settings["config"])
    (run / "config.json").write_text(json.dumps(settings))
    assert open_run(run)[1] == config
    train(config, run, progress=False)
    assert digest(run) == whole


def test_weights_in_a_file_of_older_words_are_an_mlps(tmp_path):
    architecture = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=8)
    network, path = architecture.build(), tmp_path / "agent.safetensors"
    older = replace(architecture)
    object.__setattr__(older, "name", "small")  # which no longer can be asked for
    path.write_bytes(weights(network, older, "maze"))
    loaded, found = load(path, "maze")
    assert found == architecture
    planes = torch.randint(0, 2, (3, 4, 7, 7), dtype=torch.uint8)
    assert torch.equal(loaded(planes)[0], network(planes)[0])
