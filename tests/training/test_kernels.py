"""Our kernels for the mlp and PPO's loss say what torch and autograd say."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn.functional import cosine_similarity

from astray.agents.mlp import MLP
from astray.training import ppo
from astray.training.config import PRESETS
from astray.training.fast import fused, sparse
from astray.training.fast.acceleration import resolve
from astray.training.loop import collect, update
from astray.training.trainer import Trainer

SMALL = replace(
    PRESETS["small"], variant="corner-small", num_envs=32, num_steps=16, minibatches=4, width=24
)
LARGEST = {"maze": (1, 1, 6, 6), "flags alone": (1, 1, 1), "categories alone": (5, 3)}


def planes_of(largest, size=20):
    """Random planes [size, C, 5, 3], most of them 0, one sample empty and one full."""
    random = np.random.default_rng(0)
    planes = random.integers(0, np.array(largest)[:, None, None] + 1, (size, len(largest), 5, 3))
    planes *= random.random(planes.shape) < 0.4
    planes[0], planes[1] = 0, 1
    return torch.from_numpy(planes.astype(np.uint8))


def gradients(network, outputs):
    """Of an arbitrary function of `outputs` [B, actions + 1], as one vector."""
    network.zero_grad()
    (outputs.sin() * torch.arange(outputs.shape[1])).sum().backward()
    return torch.cat([p.grad.flatten() for p in network.parameters()])


@pytest.mark.parametrize("largest", LARGEST.values(), ids=LARGEST)
def test_the_sparse_network_is_the_dense_one(largest):
    torch.manual_seed(0)
    planes = planes_of(largest)
    network = MLP(planes.shape[1:], list(largest), 15, width=24)
    for bias in (network.features.linear1.bias, network.policy.bias):
        bias.data.normal_()
    logits, value = network(planes)
    dense, fast = torch.cat([logits, value[:, None]], 1), sparse.outputs(network, planes)
    torch.testing.assert_close(fast, dense, atol=1e-5, rtol=1e-5)
    expected = gradients(network, dense)
    torch.testing.assert_close(gradients(network, fast), expected, atol=1e-4, rtol=1e-4)


def test_bfloat16_is_only_between_the_hidden_layers_and_near():
    torch.manual_seed(0)
    planes = planes_of((1, 1, 6, 6), 500)
    network = MLP(planes.shape[1:], [1, 1, 6, 6], 15, width=256)
    exact, rounded = (
        sparse.outputs(network, planes, kind) for kind in (torch.float32, torch.bfloat16)
    )
    assert 0 < (exact - rounded).abs().max() < 0.02 * exact.abs().max()
    one, two = gradients(network, exact), gradients(network, rounded)
    assert one.dtype == two.dtype == torch.float32
    assert 0.999 < cosine_similarity(one, two, 0) < 1
    assert (one.norm() / two.norm()).item() == pytest.approx(1, abs=0.01)


def test_the_kernels_round_to_bfloat16_and_pass_the_relu_as_torch_does():
    bits = np.random.default_rng(0).integers(0, 2**32, 100_000, np.uint32)
    bits[:1000] = (bits[:1000] & 0xFFFF0000) | 0x8000  # in the middle between two
    sums = np.where(np.isfinite(bits.view(np.float32)), bits, 0x7F800000).view(np.float32)
    expected = torch.from_numpy(sums).relu().bfloat16()
    rows, values, ends = np.empty(0, np.int32), np.empty(0, np.float32), np.zeros(2, np.int64)
    kept = np.empty((1, len(sums)), np.int16)
    sparse.add_rows(ends, rows, values, sums[None], sums, kept)
    assert (kept[0] == expected.view(torch.int16).numpy()).all()
    grad, passed = torch.randn(len(sums)).bfloat16(), np.zeros_like(sums)
    sparse.add_to_rows(
        ends, rows, values, kept, grad.view(torch.int16).numpy()[None], sums[None], passed
    )
    assert (passed == grad.float().where(expected > 0, 0).numpy()).all()
    output, exact = torch.randn(len(sums)), sums[None].copy()
    sparse.pass_relu(exact, output.numpy()[None], kept)
    expected = torch.from_numpy(sums).where(output > 0, 0)
    assert (exact[0] == expected.numpy()).all()
    assert (kept[0] == expected.bfloat16().view(torch.int16).numpy()).all()


def test_the_fused_loss_is_the_plain_one():
    g, config = torch.Generator().manual_seed(0), PRESETS["paper"]
    outputs = (2 * torch.randn(1000, 16, generator=g)).requires_grad_()
    noise = torch.randn(4, 1000, generator=g)
    action = torch.randint(0, 15, (1000,), generator=g)
    was = torch.log_softmax(outputs.detach()[:, :-1], 1).gather(1, action[:, None])[:, 0]
    value = outputs.detach()[:, -1] + 0.3 * noise[1]
    samples = ppo.Samples(outputs, action, was + 0.3 * noise[0], value, *noise[2:])
    plain = ppo.loss(lambda x: (x[:, :-1], x[:, -1]), samples, config)
    plain["loss"].backward()
    expected, outputs.grad = outputs.grad, None
    weights = config.clip, config.value_weight, config.entropy_weight
    loss, parts = fused.loss(outputs, samples, weights)
    loss.backward()
    torch.testing.assert_close(outputs.grad, expected, atol=1e-7, rtol=1e-4)
    assert loss.item() == pytest.approx(plain["loss"].item(), rel=1e-5)
    for name, part in zip(fused.PARTS, parts, strict=True):
        assert part.item() == pytest.approx(plain[name].item(), rel=1e-5), name
    assert 0.2 < plain["clip_fraction"] < 0.8


def test_an_iteration_with_kernels_is_the_one_without():
    weights, metrics = [], []
    for kernels in (False, True):
        # So sure of its actions that rounding changes none.
        trainer = Trainer(SMALL.changed(fused_cpu=kernels, bfloat16=False))
        trainer.network.get_parameter("policy.weight").data.mul_(1e6)
        metrics.append(update(trainer, collect(trainer), 1e-3))
        weights.append(torch.cat([p.detach().flatten() for p in trainer.network.parameters()]))
    one, two = weights
    torch.testing.assert_close(one, two, atol=1e-4, rtol=1e-3)
    assert metrics[0].keys() == metrics[1].keys()


@pytest.mark.parametrize("change", [{"device": "cuda"}, {"network": "impala"}])
def test_kernels_are_left_where_there_are_none_and_explained_where_asked_for(change):
    assert not resolve(SMALL.changed(**change)).fused_cpu
    with pytest.raises(ValueError, match="fused_cpu must be off with device="):
        resolve(SMALL.changed(fused_cpu=True, **change))
    assert resolve(SMALL).fused_cpu and not resolve(SMALL.changed(fused_cpu=False)).fused_cpu
