"""Any checkpoint is an agent and its training, or is refused."""

import json
from dataclasses import asdict

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import save as to_bytes

from astray.agents import policy
from astray.training import checkpoint
from helpers.anything import ANYTHING, CONFIG, changed, tried, tries


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A trainer, and the folder of its checkpoint."""
    folder = tmp_path_factory.mktemp("run")
    trainer = checkpoint.Trainer(CONFIG)
    for parameter in trainer.network.parameters():
        parameter.grad = parameter * 0
    trainer.optimizer.step()
    checkpoint.save(folder, trainer)
    return trainer, folder / "checkpoints" / "0"


@tries(30)
@given(data=st.data())
def test_a_ruined_agent_is_refused_or_an_agent(data, saved):
    path = saved[1].parent / "agent.safetensors"
    before = (saved[1] / checkpoint.AGENT).read_bytes()
    path.write_bytes(changed(data, before))
    try:
        network, _ = policy.load(path, "maze")
    except ValueError as error:
        assert str(error).startswith(str(path)) and path.read_bytes() != before
        tried("agents", 1)
        return
    shapes = [p.shape for p in saved[0].network.parameters()]
    assert [p.shape for p in network.parameters()] == shapes
    tried("agents", 0)


@tries(30)
@given(data=st.data())
def test_an_architecture_is_refused_or_that_of_its_weights(data, saved):
    path = saved[1].parent / "agent.safetensors"
    network, architecture = policy.load(saved[1] / checkpoint.AGENT, "maze")
    told = asdict(architecture)
    for _ in range(data.draw(st.integers(0, 2))):
        told[data.draw(st.sampled_from([*told, "more"]))] = data.draw(
            ANYTHING | st.integers(-1, 10**12) | st.lists(st.integers(-1, 10**6), max_size=4)
        )
    header = policy.header("maze", architecture=told)
    path.write_bytes(to_bytes(network.state_dict(), header))
    try:
        again, found = policy.load(path, "maze")
    except ValueError:
        assert told != asdict(architecture)
        tried("architectures", 1)
        return
    assert json.loads(json.dumps(asdict(found))) == json.loads(json.dumps(told))
    weights, others = network.state_dict(), again.state_dict()
    assert weights.keys() == others.keys()
    assert all(torch.equal(weights[name], others[name]) for name in weights)
    tried("architectures", 0)


@tries(15)
@given(data=st.data())
def test_a_ruined_trainer_is_refused_or_goes_on(data, saved):
    trainer, folder = saved
    path = folder / checkpoint.TRAINER
    whole = path.read_bytes()
    path.write_bytes(changed(data, whole))
    try:
        checkpoint.restore(folder.parent.parent, trainer)
        tried("trainers", 0)
        env = trainer.player.envs[0]
        env.game.check(env.states, env.variant)
    except ValueError:
        assert path.read_bytes() != whole
        tried("trainers", 1)
    finally:
        path.write_bytes(whole)
