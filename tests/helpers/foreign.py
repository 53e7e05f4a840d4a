"""Agents in the formats that others write them in, made here with random weights."""

import io
import itertools
import json
import os
import pickle
from collections import OrderedDict, defaultdict
from typing import Any

import msgpack
import numpy as np
import pytest
import torch
from torch import nn

from astray.agents.clear import BLOCKS


def procgen_of_envpool(task="CoinrunEasy-v0", **options):
    """EnvPool's Procgen, one environment; the test is skipped where it or its Qt is missing."""
    envpool = pytest.importorskip("envpool")
    try:
        return envpool.make_gymnasium(task, num_envs=1, **options)
    except (ImportError, AssertionError) as error:
        pytest.skip(f"EnvPool's Procgen does not run: {error}")


def joblib_bytes(data, alignment=None):
    """What joblib.dump writes of `data`, uncompressed: arrays lie bare after their description."""
    file = io.BytesIO()

    class Pickler(pickle._Pickler):
        def save(self, obj, save_persistent_id=True):
            if not isinstance(obj, np.ndarray) or obj.dtype.hasobject:
                return super().save(obj, save_persistent_id)
            fortran = obj.flags.f_contiguous and not obj.flags.c_contiguous
            state = {
                "subclass": np.ndarray,
                "shape": obj.shape,
                "order": "CF"[fortran],
                "dtype": obj.dtype,
                "allow_mmap": True,
            }
            if alignment:
                state["numpy_array_alignment_bytes"] = alignment
            self.write(b"cjoblib.numpy_pickle\nNumpyArrayWrapper\n)\x81")
            super().save(state)
            self.write(b"b")
            if alignment:
                self.write(b"\x03\xff\xff\xff")
            self.write(obj.tobytes("F" if fortran else "C"))

    Pickler(file, 3).dump(data)
    return file.getvalue()


def clarity(actions=15, **args):
    """A file of RL-Clarity with random weights; and these."""
    random = np.random.default_rng(1)
    inputs = (3, 16, 32, 32, 32)
    afters = [width for widths in BLOCKS for width in widths]
    params = {}
    for name, before, after, side in zip(
        ("1a", "2a", "2b", "3a", "4a"), inputs, afters, (7, 5, 5, 5, 5), strict=True
    ):
        kernel = random.normal(size=(side, side, before, after)) / (side * before**0.5)
        params[f"ppo2_model/pi/{name}/conv2d/kernel:0"] = kernel
        params[f"ppo2_model/pi/{name}/conv2d/bias:0"] = random.normal(size=after) / 4
    for name, kernel, bias, before, after in (
        ("pi/dense", "kernel", "bias", 512, 256),
        ("pi/dense_1", "kernel", "bias", 256, 512),
        ("pi", "w", "b", 512, actions),
        ("vf", "w", "b", 512, 1),
    ):
        params[f"ppo2_model/{name}/{kernel}:0"] = random.normal(size=(before, after)) / before**0.5
        params[f"ppo2_model/{name}/{bias}:0"] = random.normal(size=after) / 4
    params = {name: array.astype(np.float32) for name, array in params.items()}
    told = {"env_name": "coinrun", "cnn": "clear", "use_lstm": 0, "gamma": 0.999} | args
    extra = defaultdict(float, reward=np.float32(9.9))
    return {"args": told, "params": OrderedDict(params), "extra": extra}, params


def reference(widths):
    """State of a network built as train-procgen-pytorch names its parts, and its forward."""
    torch.manual_seed(widths[0])

    def block(before, after):
        def residual():
            parts = {f"conv{k}": nn.Conv2d(after, after, 3, padding=1) for k in (1, 2)}
            return nn.ModuleDict(parts)

        return nn.ModuleDict(
            {"conv": nn.Conv2d(before, after, 3, padding=1), "res1": residual(), "res2": residual()}
        )

    embedder = {
        f"block{k}": block(*pair) for k, pair in enumerate(itertools.pairwise((3, *widths)), 1)
    }
    embedder["fc"] = nn.Linear(64 * widths[2], 256)
    network: Any = nn.ModuleDict(
        {
            "embedder": nn.ModuleDict(embedder),
            "fc_policy": nn.Linear(256, 15),
            "fc_value": nn.Linear(256, 1),
        }
    )

    def forward(images):
        x = images.permute(0, 3, 1, 2).float() / 255
        for k in (1, 2, 3):
            part = network["embedder"][f"block{k}"]
            x = nn.functional.max_pool2d(part["conv"](x), 3, 2, 1)
            for name in ("res1", "res2"):
                inner = part[name]["conv1"](x.relu())
                x = x + part[name]["conv2"](inner.relu())
        x = network["embedder"]["fc"](x.relu().flatten(1)).relu()
        return network["fc_policy"](x), network["fc_value"](x)[:, 0]

    return network.state_dict(), forward


def as_pfrl(state, sequences="conv_seqs", heads=("hidden_fc", "logits_fc", "value_fc")):
    """The weights of `reference` by the names that train-procgen-pfrl gives them."""
    names = dict(zip(("embedder.fc", "fc_policy", "fc_value"), heads, strict=True))
    for block in (1, 2, 3):
        there = f"{sequences}.{block - 1}"
        names[f"embedder.block{block}.conv"] = f"{there}.conv"
        for unit, conv in itertools.product((1, 2), (1, 2)):
            here = f"embedder.block{block}.res{unit}.conv{conv}"
            names[here] = f"{there}.res_block{unit - 1}.conv{conv - 1}"
    parted = {name: name.rpartition(".") for name in state}
    return {f"{names[layer]}.{kind}": state[n] for n, (layer, _, kind) in parted.items()}


def as_cleanrl(state):
    """The weights of `reference` by the names that CleanRL's ppo_procgen gives them."""
    return as_pfrl(state, "network", ("network.5", "actor", "critic"))


def cleanba(widths=(16, 32, 32), actions=15, **args):
    """A file of cleanba with random weights, and a naive forward of these.

    Images [N, 64, 64, 3] -> logits, values. A window of a pool begins at its own first pixel, as
    "SAME" has it for even sides, and ends with the picture.
    """
    random = np.random.default_rng(2)

    def layer(*shape):
        scale = np.prod(shape[:-1]) ** -0.5
        return {
            "kernel": (random.normal(size=shape) * scale).astype(np.float32),
            "bias": random.normal(size=shape[-1]).astype(np.float32),
        }

    network = {}
    for k, (before, after) in enumerate(itertools.pairwise((3, *widths))):
        units = [{f"Conv_{c}": layer(3, 3, after, after) for c in (0, 1)} for _ in (0, 1)]
        network[f"ConvSequence_{k}"] = {
            "Conv_0": layer(3, 3, before, after),
            **{f"ResidualBlock_{u}": unit for u, unit in enumerate(units)},
        }
    network["Dense_0"] = layer(64 * widths[2], 256)
    actor, critic = {"Dense_0": layer(256, actions)}, {"Dense_0": layer(256, 1)}

    def convolve(x, conv):
        padded = np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), (1, 2))
        return np.einsum("nyxcij,ijco->nyxo", windows, conv["kernel"], optimize=True) + conv["bias"]

    def pool(x):
        side = x.shape[1] // 2
        rows = [x[:, 2 * i : 2 * i + 3].max(1) for i in range(side)]
        x = np.stack(rows, 1)
        return np.stack([x[:, :, 2 * j : 2 * j + 3].max(2) for j in range(side)], 2)

    def forward(images):
        x = images / 255.0
        for sequence in (network[f"ConvSequence_{k}"] for k in range(3)):
            x = pool(convolve(x, sequence["Conv_0"]))
            for unit in (sequence["ResidualBlock_0"], sequence["ResidualBlock_1"]):
                inner = convolve(np.maximum(x, 0), unit["Conv_0"])
                x = x + convolve(np.maximum(inner, 0), unit["Conv_1"])
        x = np.maximum(x, 0).reshape(len(x), -1)
        dense = [one["Dense_0"] for one in (network, actor, critic)]
        x = np.maximum(x @ dense[0]["kernel"] + dense[0]["bias"], 0)
        logits, values = (x @ d["kernel"] + d["bias"] for d in dense[1:])
        return logits, values[:, 0]

    modules = {str(k): {"params": one} for k, one in enumerate((network, actor, critic))}
    told = {"env_id": "CoinrunHard-v0", "gamma": 0.999, "seed": 1, "target_kl": None} | args
    return flax_bytes({"0": told, "1": modules}), forward


NET = {
    "_type_": "cleanba.convlstm:ConvLSTMConfig", "norm": {"_type_": "cleanba.network:IdentityNorm"},
    "normalize_input": False, "residual": False, "use_relu": False, "skip_final": True,
    "head_scale": 1, "mlp_hiddens": [9], "n_recurrent": 3, "repeats_per_step": 2,
    "yang_init": False,
}  # fmt: skip
CELLS = {
    "pool_and_inject": "horizontal", "pool_projection": "per-channel", "fence_pad": "valid",
    "output_activation": "tanh", "forget_bias": 0.0,
}  # fmt: skip


def square(size, features):
    """Settings of one of their convolutions."""
    return {"features": features, "kernel_size": [size, size], "strides": [1, 1],
            "padding": "SAME", "use_bias": True, "initialization": "lecun"}  # fmt: skip


def sokoban_planner(folder, side=5, channels=4, actions=4, devices=0, **changed):
    """Write a checkpoint of train-learned-planner with random weights to `folder`.

    Returns a naive forward of these for one episode, after their description: images
    [T, side, side, 3] -> logits [T, actions], values [T].
    """
    random = np.random.default_rng(3)
    net = {k: changed.get(k, v) for k, v in NET.items()}
    cell = {k: changed.get(k, v) for k, v in CELLS.items()} | {"conv": square(3, channels)}
    net |= {"embed": changed.get("embed", [square(4, channels)] * 2), "recurrent": cell}

    def weights(*shape):
        return (random.normal(size=shape) * np.prod(shape[:-1]) ** -0.5).astype(np.float32)

    def layer(*shape, bias=True):
        return {"kernel": weights(*shape)} | ({"bias": weights(shape[-1])} if bias else {})

    network = {
        f"conv_list_{k}": layer(4, 4, 3 if k == 0 else channels, channels)
        for k in range(len(net["embed"]))
    }
    for d in range(net["n_recurrent"]):
        one = {"ih": layer(3, 3, 3 * channels, 4 * channels)}
        one["hh"] = layer(3, 3, channels, 4 * channels, bias=False)
        one["fence"] = layer(3, 3, 1, 4 * channels, bias=False)
        one["project"] = weights(2, channels)
        network[f"cell_list_{d}"] = one
    network["dense_list_0"] = layer(side * side * channels, 9)
    params = {
        "network_params": network,
        "actor_params": {"Output": layer(9, actions)},
        "critic_params": {"Output": layer(9, 1)},
    }

    def convolve(x, conv, pad=True):
        size = len(conv["kernel"])
        before, after = ((size - 1) // 2, size // 2) if pad else (0, 0)
        padded = np.pad(x, ((before, after), (before, after), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size), (0, 1))
        out = np.einsum("yxcij,ijco->yxo", windows, conv["kernel"])
        return out + conv.get("bias", 0)

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    def pooled(one, hidden):
        most, mean = hidden.max((0, 1)), hidden.mean((0, 1))
        return one["project"][0] * most + one["project"][1] * mean

    def fenced(one):
        plane = np.ones((side + 2, side + 2, 1))
        plane[1:-1, 1:-1] = 0
        return convolve(plane, one["fence"], pad=False)

    def tick(one, seen, below, hidden, inner):
        about = np.broadcast_to(pooled(one, hidden), hidden.shape)
        gates = convolve(np.concatenate([seen, below, about], -1), one["ih"])
        new, into, forget, out = np.split(
            gates + convolve(hidden, one["hh"]) + fenced(one), 4, axis=-1
        )
        inner = inner * sigmoid(forget) + np.tanh(new) * sigmoid(into)
        return np.tanh(inner) * np.tanh(out), inner

    def forward(images):
        depth, said = net["n_recurrent"], []
        hidden = [np.zeros((side, side, channels)) for _ in range(depth)]
        inner = list(hidden)
        for image in images:
            seen = image / 255.0
            for k in range(len(net["embed"])):
                seen = convolve(seen, network[f"conv_list_{k}"])
            for _ in range(net["repeats_per_step"]):
                below = hidden[-1]
                for d in range(depth):
                    one = network[f"cell_list_{d}"]
                    below, inner[d] = tick(one, seen, below, hidden[d], inner[d])
                    hidden[d] = below
            x = (below + seen).reshape(-1)
            heads = [network["dense_list_0"], *(params[f"{h}_params"]["Output"] for h in
                     ("actor", "critic"))]  # fmt: skip
            x = np.maximum(x @ heads[0]["kernel"] + heads[0]["bias"], 0)
            logits, value = (x @ head["kernel"] + head["bias"] for head in heads[1:])
            said.append((logits, value[0]))
        logits, values = zip(*said, strict=True)
        return np.array(logits), np.array(values)

    def of_devices(tree):
        if isinstance(tree, dict):
            return {name: of_devices(branch) for name, branch in tree.items()}
        return np.stack([tree] * devices) if devices else tree

    state = {"step": 7, "params": {"params": of_devices(params)}, "opt_state": {"0": {}}}
    folder.mkdir(exist_ok=True)
    (folder / "model").write_bytes(flax_bytes(state))
    (folder / "cfg.json").write_text(json.dumps({"cfg": {"net": net}, "update_step": 7}))
    return forward


def flax_bytes(data):
    """What flax.serialization.to_bytes writes of plain containers and arrays."""

    def packed(value):
        parts = (value.shape, value.dtype.name, value.tobytes())
        return msgpack.ExtType(1, msgpack.packb(parts))

    return msgpack.packb(data, default=packed)


def saved(data):
    file = io.BytesIO()
    torch.save(data, file)
    return file.getvalue()


class Runs:
    """Runs a command where it is unpickled."""

    def __reduce__(self):
        return os.system, ("echo ran >> /dev/null",)
