"""Networks of one's own that draw: what they drop is the same whether or not a run was stopped."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

import astray
from astray.agents.mlp import MLP
from astray.training import checkpoint
from astray.training.loop import train
from helpers.trainings import PLAIN, digest

pytestmark = pytest.mark.filterwarnings("ignore:training runs the network:UserWarning")


class Dropping(MLP):
    """With dropout before its first layer's units are looked at."""

    def __init__(self, architecture):
        super().__init__(
            architecture.shape, list(architecture.largest), architecture.actions, architecture.width
        )
        self.drop = nn.Dropout(0.5)

    def forward(self, observations):
        logits, value = super().forward(observations)
        return self.drop(logits), value


def test_a_run_that_was_stopped_has_the_weights_of_one_that_was_not(tmp_path):
    train(PLAIN, tmp_path / "whole", network=Dropping, progress=False)
    torch.manual_seed(1)
    for iteration in astray.iterate(PLAIN, tmp_path / "stopped", network=Dropping):
        torch.rand(1)
        if iteration.number == 2:
            break
    train(PLAIN, tmp_path / "stopped", network=Dropping, progress=False)
    assert digest(tmp_path / "stopped") == digest(tmp_path / "whole")
    assert checkpoint.metrics(tmp_path / "stopped") == checkpoint.metrics(tmp_path / "whole")


def test_a_kept_network_drops_nothing(tmp_path):
    train(PLAIN, tmp_path, network=Dropping, progress=False)
    agent = astray.load_agent(tmp_path)
    shown = np.zeros((4, *agent.architecture.shape), np.uint8)
    assert torch.equal(agent.outputs(shown)[0], agent.outputs(shown.copy())[0])


def test_who_acts_drops_nothing_and_who_learns_does(monkeypatch):
    seen, forward = set(), Dropping.forward

    def watched(self, observations):
        seen.add((torch.is_grad_enabled(), self.training))
        return forward(self, observations)

    monkeypatch.setattr(Dropping, "forward", watched)
    for iteration in astray.iterate(replace(PLAIN, steps=512), network=Dropping):
        assert not iteration.trainer.network.training
    assert seen == {(False, False), (True, True)}


def test_the_callers_random_numbers_are_its_own():
    torch.manual_seed(3)
    before = torch.get_rng_state()
    for _ in astray.iterate(PLAIN, network=Dropping):
        assert torch.equal(torch.get_rng_state(), before)
