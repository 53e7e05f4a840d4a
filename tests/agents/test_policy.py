"""Files of agents: what is refused of the weights in one."""

from dataclasses import asdict

import pytest
import torch
from safetensors.torch import save

from astray.agents import policy
from astray.training import folders
from astray.training.folders import AgentFolder


# Of 64 bits they could be more than 32 hold, and a page without Python reads these alone.
@pytest.mark.parametrize("kind", [torch.int64, torch.bool, torch.float64, torch.float16])
def test_weights_of_other_numbers_than_the_networks_are_refused(kind, tmp_path):
    architecture = policy.Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=8)
    network, path = architecture.build(), tmp_path / "agent.safetensors"
    tensors = {name: tensor.to(kind) for name, tensor in network.state_dict().items()}
    path.write_bytes(save(tensors, policy.header("maze", architecture=asdict(architecture))))
    for load in (policy.load, lambda *where: policy.load_into(network, *where)):
        with pytest.raises(ValueError, match=rf"must be torch.float32; they are {kind}"):
            load(path, "maze")


@pytest.mark.parametrize(
    "largest, said",
    [
        ((1, 1, 6), "`largest` must have a number for each plane"),
        ((1, 1, 6, 10**400), "sizes of networks must be integers from 1 to 2147483647"),
    ],
)
def test_a_network_of_planes_knows_the_largest_value_of_each(largest, said):
    with pytest.raises(ValueError, match=said):
        policy.Architecture("mlp", (4, 7, 7), largest, 15)


@pytest.mark.parametrize("name", ["patch-pooled", "cells"])
def test_an_agent_that_sees_more_than_any_picture_is_refused_before_it_is_built(name, tmp_path):
    """The weights of these networks are the same for all shapes: 60 kB took 7 GB and 113 s."""
    architecture = policy.Architecture(name, (64, 64, 3), (), 15)
    tensors, path = architecture.build().state_dict(), tmp_path / "agent.safetensors"
    told = asdict(architecture) | {"shape": [10_000, 10_000, 3]}
    path.write_bytes(save(tensors, policy.header("maze", architecture=told)))
    with pytest.raises(
        ValueError, match=r"an observation must have at most 33,554,432 numbers; its"
    ):
        policy.load(path, "maze")


def test_a_file_that_a_network_misses_is_not_taken_for_the_agents_own(monkeypatch):
    def build(self):
        raise FileNotFoundError("no vocabulary at words.txt")

    path = AgentFolder.open(folders.find("maze-corner")).weights
    monkeypatch.setattr(policy.Architecture, "build", build)
    with pytest.raises(ValueError, match=r"not an agent that can be used: no vocabulary at words"):
        policy.load(path, "maze")


def test_a_header_of_many_arrays_is_refused_before_it_is_read(tmp_path):
    """One of 22 MB took 20 s and 0.4 GB; the library reads up to 100 MB."""
    empty = '"%d":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}'
    told = ("{" + ",".join(empty % k for k in range(20_000)) + "}").encode()
    path = tmp_path / "agent.safetensors"
    path.write_bytes(len(told).to_bytes(8, "little") + told)
    with pytest.raises(ValueError, match="its header must be of at most 1,048,576 bytes; it has"):
        policy.load(path, "maze")
