"""Importer of CleanRL's PPO agents on Procgen: IMPALA networks of torch, or in Flax's msgpack.

Weights of torch are those of `ppo_procgen.py`, which `pth` reads. A file of Flax is cleanba's: it
holds the training's settings and the parameters of three modules: network, actor and critic
(`cleanba_ppo_envpool_procgen.py`). Kernels are [height, width, in, out], the dense layer's inputs
are ordered by rows, columns, channels, and max-pooling is padded as "SAME": "impala-same".
"""

import itertools
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.agents.importers import pth
from astray.agents.importers.imported import Imported, impala, plain_settings, turned
from astray.validation import shown

ZIP = b"PK"  # with which files of torch begin
ARRAY, SCALAR = 1, 3  # Flax's extension types
PARTS = 2000  # of a list or dict, and of these and arrays themselves; a network has some 50
DEEPEST = 8  # names on the way to a parameter; the network's have 4
KINDS = ("float16", "float32", "float64", "int32", "int64", "uint8", "bool")  # of their numbers
DENSE = {"0": "features.linear", "1": "policy", "2": "value"}  # by the module that has them
# Settings of a training: the file's names and ours.
SETTINGS = {
    "gamma": "gamma", "gae_lambda": "lam", "learning_rate": "learning_rate", "clip_coef": "clip",
    "ent_coef": "entropy_weight", "num_steps": "num_steps", "update_epochs": "epochs",
    "num_minibatches": "minibatches", "total_timesteps": "steps", "seed": "seed",
}  # fmt: skip


def read(data: bytes) -> Imported:
    """Return the agent in the bytes of a .cleanrl_model file.

    Raises:
        ValueError: If the bytes are damaged, hold another network, or msgpack is not installed.
    """
    if data.startswith(ZIP):
        return pth.read(data)
    match unpacked(data):
        case {"0": dict(told), "1": {"0": network, "1": actor, "2": critic}}:
            modules = {"0": network, "1": actor, "2": critic}
        case _:
            raise ValueError("it holds no settings and three modules, as cleanba's files do")
    tensors = dict(_tensors(modules))
    told = plain_settings(told, (*SETTINGS, "env_id"))
    ours = {here: told[there] for there, here in SETTINGS.items() if told.get(there) is not None}
    more = _world(told.get("env_id")), ours, told
    return impala("impala-same", tensors, "CleanRL's cleanba", *more)


def unpacked(data: bytes) -> Any:
    """Return what Flax's msgpack holds; raise ValueError if it is damaged or holds more."""
    try:
        import msgpack
    except ImportError:
        raise ValueError("reading it takes the package msgpack: pip install msgpack") from None

    left = itertools.repeat(None, PARTS)  # a byte of a file could be a list, of 60 bytes

    def counted(several: Any) -> Any:
        if next(left, several) is several:
            raise ValueError(f"it has more than {PARTS:,} lists, dictionaries and arrays")
        return several

    def extended(code: int, packed: bytes) -> Any:
        if code not in (ARRAY, SCALAR):
            raise ValueError(f"it has the extension {code}, which is not an array")
        shape, kind, raw = counted(msgpack.unpackb(packed, **how))
        if kind not in KINDS:
            raise ValueError(f"it has an array of {shown(kind)}; only numbers are read")
        array = np.frombuffer(raw, kind).reshape(shape)
        return array if code == ARRAY else array.item()

    how: Any = {"list_hook": counted, "object_hook": counted}
    how |= {"max_array_len": PARTS, "max_map_len": PARTS}
    try:
        return msgpack.unpackb(data, ext_hook=extended, **how)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        why = str(error) or type(error).__name__
        raise ValueError(f"it is damaged, or not msgpack: {why}") from error


def _tensors(modules: Mapping[str, Any]) -> Iterator[tuple[str, Tensor]]:
    """Yield the parameters by our names, in torch's layout."""
    for number, module in modules.items():
        for path, array in leaves(module.get("params") if isinstance(module, dict) else None):
            if (layer := _layer(number, path)) is None:
                raise ValueError(f"it has {'/'.join(path)}, which cleanba's network does not")
            if path[-1] == "bias":
                yield f"{layer}.bias", torch.from_numpy(array.copy())
            else:  # after three halvings, a picture is 8 x 8
                yield f"{layer}.weight", turned(array, 8 if number == "0" else 0)


def leaves(tree: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """Yield the arrays of a tree with their paths; raise ValueError for anything else."""
    is_clear = isinstance(tree, dict) and "/" not in "".join(map(str, tree))
    if is_clear and tree and len(path) < DEEPEST:
        for name, branch in tree.items():
            yield from leaves(branch, (*path, str(name)))
    elif isinstance(tree, np.ndarray) and path:
        yield path, tree
    else:
        raise ValueError(f"it has {'/'.join(path) or 'a module'} without parameters")


def _layer(module: str, path: tuple[str, ...]) -> str | None:
    """Return our name of the layer at `path` of a module, or None if the network has none."""
    name = "/".join(path)
    if re.fullmatch("Dense_0/(kernel|bias)", name):
        return DENSE[module]
    found = re.fullmatch(
        r"ConvSequence_([0-2])/(?:ResidualBlock_([01])/)?Conv_([01])/(kernel|bias)", name
    )
    if module != "0" or found is None or (found[2] is None and found[3] != "0"):
        return None
    unit = "conv" if found[2] is None else f"residual{int(found[2]) + 1}.conv{int(found[3]) + 1}"
    return f"block{int(found[1]) + 1}.{unit}"


def _world(name: Any) -> tuple[str, str] | None:
    """Return Procgen's name and difficulty for an EnvPool id such as CoinrunHard-v0."""
    found = re.fullmatch(r"([A-Za-z]+)(Easy|Hard|Memory|Extreme)-v0", str(name))
    return (found[1].lower(), found[2].lower()) if found else None
