"""Importer of RL-Clarity agents: OpenAI's "clear" networks in joblib files.

A file holds `args` (the training's settings) and `params` (arrays in TensorFlow's layout, named as
in Baselines' ppo2). The network divides images by 255, as `clear_cnn` of tensorflow/lucid does,
and actions are sampled from the policy.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.agents.clear import BLOCKS
from astray.agents.importers import plain
from astray.agents.importers.imported import Imported, of_procgen, plain_settings, turned
from astray.validation import shown

SCOPE = "ppo2_model/"
CONVOLUTIONS = {
    "pi/1a/conv2d": "block1.conv1", "pi/2a/conv2d": "block2.conv1", "pi/2b/conv2d": "block2.conv2",
    "pi/3a/conv2d": "block3.conv1", "pi/4a/conv2d": "block4.conv1",
}  # fmt: skip
DENSE = {"pi/dense": "features.linear1", "pi/dense_1": "features.linear2"}
HEADS = {"pi": "policy", "vf": "value"}
# Of a training, as the files name them and as we do.
SETTINGS = {
    "gamma": "gamma", "lambda": "lam", "learning_rate": "learning_rate", "clip_range": "clip",
    "entropy_coeff": "entropy_weight", "num_envs": "num_envs", "num_steps": "num_steps",
    "ppo_epochs": "epochs", "num_minibatches": "minibatches", "start_level": "first_level",
    "num_levels": "levels",
}  # fmt: skip


def read(data: bytes) -> Imported:
    """Return the agent in the bytes of a .jd file; raise ValueError if it cannot be imported."""
    found = plain.read(data)
    if not isinstance(found, dict) or not all(
        isinstance(found.get(name), dict) for name in ("args", "params")
    ):
        raise ValueError("it has no args and params, as files of RL-Clarity have")
    settings = found["args"]
    network = settings.get("cnn", settings.get("arch", "clear"))
    if not isinstance(network, str) or network != "clear":
        raise ValueError(f"its network is {shown(network)}; of RL-Clarity's only 'clear' is read")
    told = plain_settings(settings, (*SETTINGS, "env_name", "distribution_mode"))
    if told.get("use_lstm"):
        raise ValueError("it is a recurrent agent; only feed-forward ones are read")
    weights = _weights(found["params"])
    ours = {here: told[there] for there, here in SETTINGS.items() if told.get(there) is not None}
    if not ours.get("levels"):  # Procgen's 0, and what is not set, mean: all levels there are
        ours = {name: said for name, said in ours.items() if name not in ("levels", "first_level")}
    if told.get("reward_processing") == "none":
        ours["normalise_reward"] = False
    for name in ("env_name", "distribution_mode"):
        if not isinstance(told.get(name), str | None):
            raise ValueError(f"its setting {name} must be text; got {told[name]!r}")
    mode = "hard" if told.get("distribution_mode") is None else told["distribution_mode"]
    world = (str(told["env_name"]), str(mode)) if told.get("env_name") else None
    return of_procgen("clear", weights, 'RL-Clarity: the "clear" network', world, ours, told)


def _weights(params: dict[Any, Any]) -> dict[str, Tensor]:
    """Return the arrays in torch's layout, under astray's names."""
    weights = {}
    for name, array in params.items():
        if not isinstance(name, str) or not isinstance(array, np.ndarray):
            raise ValueError(f"its params have {shown(name)}, which is not an array")
        layer, _, part = name.removeprefix(SCOPE).removesuffix(":0").rpartition("/")
        renamed = (CONVOLUTIONS | DENSE | HEADS).get(layer)
        if renamed is None:
            raise ValueError(f"its params have {shown(name)}, which the clear network does not")
        is_bias = part in ("bias", "b")
        if (ours := f"{renamed}.{'bias' if is_bias else 'weight'}") in weights:
            raise ValueError(f"it has two weights of the same layer, as {shown(name)}")
        if is_bias:
            weights[ours] = torch.from_numpy(array)
        else:
            seen = array.shape[0] if layer == "pi/dense" and array.ndim else 0  # as 4 x 4 x 32
            side = math.isqrt(seen // BLOCKS[-1][-1])
            weights[ours] = turned(array, side)
    return weights
