"""Learning by parts gives the gradient of the whole."""

from dataclasses import replace

import pytest
import torch

from astray.training import ppo
from astray.training.fast import acceleration
from astray.training.fast.acceleration import Acceleration, Model
from astray.training.loop import collect
from astray.training.trainer import Trainer
from helpers.trainings import OFF, PICTURES

ALIKE = 1e-5  # of float32 sums in another order


@pytest.fixture(scope="module")
def rollout():
    """A network of convolutions, and samples that it played."""
    trainer = Trainer(replace(PICTURES, network="patch"))
    samples = collect(trainer).flat()
    yield trainer.network, samples
    trainer.close()


def gradients(network, loss):
    return torch.cat([g.flatten() for g in torch.autograd.grad(loss, list(network.parameters()))])


@pytest.mark.parametrize("size", [1, 7, 32, 63])
def test_parts_give_the_loss_and_the_gradient_of_the_whole(rollout, size):
    network, samples = rollout
    whole = ppo.loss(network, samples, PICTURES)
    parts = Model(network, ppo.loss, PICTURES, Acceleration(microbatch=size)).loss(samples)
    assert parts.keys() == whole.keys()
    for name, x in whole.items():
        assert torch.allclose(parts[name], x, rtol=ALIKE, atol=ALIKE), name
    one, two = gradients(network, whole["loss"]), gradients(network, 2 * parts["loss"])
    assert torch.allclose(two, 2 * one, rtol=1e-3, atol=ALIKE)


def test_outputs_do_not_depend_on_parts(rollout):
    network, samples = rollout
    with torch.no_grad():
        plain = network(samples.observation)
        parts = Model(network, ppo.loss, PICTURES, Acceleration(microbatch=5))(samples.observation)
    for one, two in zip(plain, parts, strict=True):
        assert torch.allclose(one, two, rtol=ALIKE, atol=ALIKE)


def test_only_convolutions_on_a_processor_learn_by_parts():
    assert acceleration.resolve(PICTURES).microbatch == 128
    assert acceleration.resolve(PICTURES.changed(microbatch=32)).microbatch == 32
    assert acceleration.resolve(PICTURES, ours=False).microbatch == 0
    with pytest.raises(ValueError, match="microbatch needs a CPU, a network of convolutions"):
        acceleration.resolve(PICTURES.changed(network="mlp", observation="symbolic", microbatch=8))


def test_images_are_rounded_for_bfloat16_as_the_first_convolution_would():
    every = torch.arange(256, dtype=torch.uint8)
    assert torch.equal(every.bfloat16() / 255, (every.float() / 255).bfloat16())
    assert "bfloat16" in OFF  # PICTURES has it off, so that the tests above compare float32
