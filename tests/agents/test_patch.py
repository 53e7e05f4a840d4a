"""Networks for images on a processor: what they see, and what they are called inside."""

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from astray.agents import policy
from astray.agents.impala import Impala
from astray.agents.patch import Convolutions
from astray.agents.policy import BUILDERS, Architecture

SHAPE = (64, 64, 3)
NAMES = [
    name
    for name in BUILDERS
    if not name.startswith("impala") and name not in ("mlp", "clear", "cells")
]


def built(name, shape=SHAPE):
    torch.manual_seed(0)
    return Architecture(name, shape, (), 9).build()


def counted(network, image):
    """Multiplications by weights for one image, by torch, which counts additions, too."""
    with FlopCounterMode(display=False) as counter:
        network(image)
    return counter.get_total_flops() // 2


@pytest.mark.parametrize("name", NAMES)
def test_images_give_logits_and_values_that_hooks_can_change(name):
    network, images = built(name), torch.randint(0, 256, (3, *SHAPE), dtype=torch.uint8)
    assert isinstance(network, Convolutions)
    logits, values = network(images)
    assert logits.shape == (3, 9) and values.shape == (3,)
    handle = network.features.relu.register_forward_hook(lambda *a: torch.zeros_like(a[2]))
    assert network(images)[0].eq(network.policy.bias).all()
    handle.remove()
    assert torch.equal(network(images)[0], logits)


@pytest.mark.parametrize("name", NAMES)
def test_they_need_far_fewer_products_than_the_papers(name):
    image = torch.zeros((1, *SHAPE), dtype=torch.uint8)
    times = {"patch": 25, "strided-impala": 3}.get(name, 5)
    assert times * counted(built(name), image) < counted(Impala(SHAPE, 9), image) == 30_607_872


@pytest.mark.parametrize("name", [*NAMES, "impala", "impala+gru", "impala+lstm", "drc-2-2"])
def test_products_are_counted_as_torch_does(name):
    network, image = built(name), torch.zeros((1, *SHAPE), dtype=torch.uint8)
    assert policy.products(network, SHAPE) == counted(network, image)
    assert not [one for one in network.modules() if one._forward_hooks]


def test_pooled_places_are_all_alike():
    """Whatever order the places are in before the mean, the last layer is given the same."""
    network = built("patch-pooled")
    planes = torch.randn(2, 16, 8, 8)
    order = torch.randperm(64)
    shuffled = planes.flatten(2)[..., order].view_as(planes)
    apart = built("patch").features
    one, two = (network.features(network.body.mean(x)) for x in (planes, shuffled))
    assert torch.allclose(one, two, atol=1e-6)
    assert not torch.allclose(apart(planes), apart(shuffled), atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_other_sizes_of_images_are_seen_too(name):
    network = built(name, (72, 80, 3))
    assert network(torch.zeros(2, 72, 80, 3, dtype=torch.uint8))[0].shape == (2, 9)


@pytest.mark.parametrize("name, first", [("strided-impala", "body.conv1"), ("cells", "stem")])
def test_the_first_convolution_sees_black_and_white_as_opposites(name, first):
    network, seen = built(name), []
    network.get_submodule(first).register_forward_pre_hook(lambda _, given: seen.append(given[0]))
    for shade in (0, 255):
        network(torch.full((1, *SHAPE), shade, dtype=torch.uint8))
    assert seen[0].eq(-2).all() and seen[1].eq(2).all()
