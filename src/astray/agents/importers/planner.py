"""Importer of planners of Sokoban from AlignmentResearch's train-learned-planner, in Flax.

    planner = read("drc33/bkynosqi/cp_2002944000")
    logits, values, state = planner.unroll(images, torch.zeros(N, planner.memory), begins)

A checkpoint is a folder: `cfg.json` has the settings, `model` the state of the training. Sokoban is
not a game here, so this is a network for observations of your own, with a pixel per cell.

It is `drc` but for three things: a hyperbolic tangent is on the output gate; the fence, by which a
place knows the border, lies around the places; and what is encoded is added to the top, instead of
set beside it, which is the same dense layer twice. This reads networks of the settings that they
published, with any depth, ticks and sizes, and refuses others with the name of what differs.
"""

import json
import math
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from astray import files
from astray.agents.drc import DRC
from astray.agents.importers.cleanrl import leaves, unpacked
from astray.agents.importers.imported import build
from astray.validation import bounded, brief, shown

MODEL, SETTINGS = "model", "cfg.json"
LARGEST = {SETTINGS: 2**20, MODEL: 512_000_000}  # bytes; DRC(3, 3) has some 20 MB
ONLY = {  # settings that are read with one value only
    "_type_": "cleanba.convlstm:ConvLSTMConfig", "norm": {"_type_": "cleanba.network:IdentityNorm"},
    "normalize_input": False, "residual": False, "use_relu": False, "skip_final": True,
    "head_scale": 1, "forget_bias": 0, "pool_and_inject": "horizontal", "fence_pad": "valid",
    "pool_projection": "per-channel", "output_activation": "tanh",
}  # fmt: skip
CELL, DENSE = "network_params/cell_list", "network_params/dense_list_0"
DEEPEST = 20  # layers, ticks, and cells a side of a fence
MOST = 10_000_000  # numbers of fences, which a file could promise without a number
GATES = (1, 2, 0, 3)  # theirs are new, into, forget, out; ours into, forget, new, out
WRONG = (ValueError, TypeError, AttributeError, IndexError, ArithmeticError, RuntimeError)


class Same(nn.Conv2d):
    """A convolution that keeps the sides, with the padding of Flax's "SAME"."""

    fence: Tensor  # [1, C, H, W], added; missing where there is none

    def forward(self, input: Tensor) -> Tensor:
        """Return [N, C, H, W] for `input` [N, D, H, W]."""
        ends = (self.kernel_size[0] - 1) // 2, self.kernel_size[0] // 2
        found = super().forward(functional.pad(input, ends * 2))
        return found + self.fence if hasattr(self, "fence") else found


class Planner(DRC):
    """Images [N, H, W, 3] uint8, a pixel per cell -> logits [N, A], values [N]; see `DRC`."""

    def __init__(self, net: Mapping[str, Any], side: int, actions: int):
        embed, (features,), cells = net["embed"], net["mlp_hiddens"], net["recurrent"]
        inputs, layers = 3, OrderedDict()
        for k, conv in enumerate(embed, 1):
            layers[f"conv{k}"] = Same(inputs, inputs := conv["features"], conv["kernel_size"][0])
        sizes = net["n_recurrent"], net["repeats_per_step"], 1, features
        shape, encoder = (side, side, 3), nn.Sequential(layers)
        super().__init__(shape, [], actions, *sizes, encoder, inputs)
        self.edge = self.edge[:, :0]  # gates have the fence
        modules: Any = self.layers
        for layer in modules:
            layer.output = torch.tanh
            layer.gates = Same(4 * inputs, 4 * inputs, cells["conv"]["kernel_size"][0])
            layer.gates.fence = nn.Parameter(torch.zeros(1, 4 * inputs, side, side))


def read(folder: str | Path) -> Planner:
    """Return the network in a checkpoint's folder, a `Recurrent`; nothing in it is run.

    Raises:
        FileNotFoundError: If the folder lacks one of its two files.
        ValueError: If they are damaged or of another network, or msgpack is not installed.
    """
    told, data = (files.read(Path(folder) / name, most) for name, most in LARGEST.items())
    try:
        settings = json.loads(told)
        net = _checked(settings.get("cfg", settings)["net"])
        arrays = dict(leaves(unpacked(data)["params"]["params"]))
        left = {"/".join(path): torch.from_numpy(array.copy()) for path, array in arrays.items()}
        if left[f"{CELL}_0/ih/kernel"].ndim == 5:  # one of each device
            left = {name: several[0] for name, several in left.items()}
        side, tensors = _converted(net, left)
        if left:
            raise ValueError(f"it has {min(left)}, which its network does not")
        return build(lambda: Planner(net, side, len(tensors["policy.bias"])), tensors).eval()
    except KeyError as error:
        raise ValueError(f"{folder} is refused: it lacks {error.args[0]}") from error
    except WRONG as error:
        raise ValueError(f"{folder} is refused: {brief(error)}") from error


def _checked(net: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a network; raise ValueError if one is of another than `Planner`."""
    cells = net["recurrent"]
    for name, wanted in ONLY.items():
        if (said := {**cells, **net}[name]) != wanted:
            raise ValueError(f"its network has {name} {shown(said)}; only {shown(wanted)} is read")
    for conv in (*net["embed"], cells["conv"]):
        size = conv["kernel_size"]
        if list(conv["strides"]) != [1, 1] or conv["padding"] != "SAME" or size[0] != size[-1]:
            raise ValueError("a convolution is not square with stride 1 and padding SAME")
    for name in ("n_recurrent", "repeats_per_step"):
        bounded(name, net[name], 1, DEEPEST)
    if len(net["mlp_hiddens"]) != 1:
        raise ValueError(f"it has {len(net['mlp_hiddens'])} dense layers; only one is read")
    return net


def _converted(net: dict[str, Any], left: dict[str, Tensor]) -> tuple[int, dict[str, Tensor]]:
    """Return the cells a side, and the weights by our names; they are taken out of `left`."""
    channels = left[f"{CELL}_0/hh/kernel"].shape[2]
    dense, found = left.pop(f"{DENSE}/kernel"), {"features.linear.bias": left.pop(f"{DENSE}/bias")}
    side, gates = math.isqrt(len(dense) // max(channels, 1)), 4 * channels
    bounded("numbers of its fences", gates * side**2 * net["n_recurrent"], 1, MOST)
    for k in range(len(net["embed"])):
        at, here = f"network_params/conv_list_{k}", f"encoder.conv{k + 1}"
        found[f"{here}.weight"] = left.pop(f"{at}/kernel").permute(3, 2, 0, 1)
        found[f"{here}.bias"] = left.pop(f"{at}/bias")
    for d in range(net["n_recurrent"]):
        at, here = f"{CELL}_{d}", f"layers.{d}"
        seen, own, fence = (left.pop(f"{at}/{name}/kernel") for name in ("ih", "hh", "fence"))
        bounded("the size of its fence", size := len(fence), 1, DEEPEST)
        if {fence.shape[1::2], own.shape[1::2]} != {(size, gates)} or not fence.numel():
            raise ValueError(f"its fence is {tuple(fence.shape)}, and a kernel {tuple(own.shape)}")
        parts = seen[:, :, : 2 * channels], own, seen[:, :, 2 * channels :]  # pooled are last
        found[f"{here}.gates.weight"] = _in_order(torch.cat(parts, 2)).permute(3, 2, 0, 1)
        found[f"{here}.gates.bias"] = _in_order(left.pop(f"{at}/ih/bias"))
        inside = torch.zeros(1, 1, side + size - 3, side + size - 3)
        kernel = _in_order(fence).sum(2, keepdim=True).permute(3, 2, 0, 1)
        plane = functional.pad(inside, (1, 1, 1, 1), value=1.0)
        found[f"{here}.gates.fence"] = functional.conv2d(plane, kernel)
        if (project := left.pop(f"{at}/project")).shape != (2, channels):
            raise ValueError(f"what it pools has the weights {tuple(project.shape)}")
        weights = map(torch.diag, project)
        found[f"{here}.pooled.weight"] = torch.cat([*weights], 1)
        found[f"{here}.pooled.bias"] = torch.zeros(channels)
    flat = dense.reshape(side, side, channels, -1).permute(2, 0, 1, 3).flatten(0, 2).T
    found["features.linear.weight"] = torch.cat([flat, flat], 1)
    for name, there in (("policy", "actor"), ("value", "critic")):
        found[f"{name}.weight"] = left.pop(f"{there}_params/Output/kernel").T
        found[f"{name}.bias"] = left.pop(f"{there}_params/Output/bias")
    return side, found


def _in_order(gates: Tensor) -> Tensor:
    """Return weights [..., 4 C] of their gates in the order of ours."""
    return gates.unflatten(-1, (4, -1))[..., GATES, :].flatten(-2)
