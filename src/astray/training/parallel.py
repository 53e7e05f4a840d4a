"""Data-parallel training: several processes train one agent with averaged gradients.

`torchrun --nproc-per-node 2 -m astray train ...` starts them, each on its own GPU or on a CPU.
They begin with equal weights and draw equal noise, so they stay equal and together play what one
process would. Only the first writes files. The one difference from a single process: a minibatch
has equally many samples of every process.
"""

import contextlib
import functools
import importlib
import itertools
import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch import distributed as dist

TRAININGS = itertools.count()  # all processes count the same


@functools.cache
def _store() -> tuple[Any, int, int]:
    """Return the store by which the processes find each other, this one's rank, and their number.

    It is opened once. Each training has its own keys in it, as those of an earlier one hold
    addresses at which nobody listens any more.
    """
    return next(dist.rendezvous("env://"))  # pyrefly: ignore


@contextlib.contextmanager
def processes(device: str) -> Iterator[None]:
    """Join torchrun's process group, if any; raise ValueError if its variables are invalid."""
    if not dist.is_available() or not dist.is_torchelastic_launched() or dist.is_initialized():
        yield
        return
    gpu = None
    if device == "cuda":
        gpu = torch.device("cuda", dist.get_node_local_rank(0))
        torch.cuda.set_device(gpu)
    # Its functions take the group that is there when it is imported as a default, which torch does
    # at the first step of an optimiser: the group would live on, and its threads may abort the
    # process when that ends.
    importlib.import_module("torch.distributed.nn.functional")
    try:
        store, rank, count = _store()
        keys = dist.PrefixStore(f"astray-{next(TRAININGS)}", store)  # pyrefly: ignore
        dist.init_process_group(
            "nccl" if gpu else "gloo", store=keys, rank=rank, world_size=count, device_id=gpu
        )
    except ValueError as error:
        raise ValueError(
            "RANK, WORLD_SIZE, MASTER_ADDR and MASTER_PORT must be as torchrun sets them in the "
            f"environment; {error}"
        ) from error
    yield
    dist.destroy_process_group()  # not after an error: it may wait for others, whom torchrun ends


def size() -> int:
    """Return the number of processes that train this agent."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def first() -> bool:
    """Return whether this process writes files, also before and after joint training."""
    if dist.is_available() and dist.is_initialized():
        return dist.get_rank() == 0
    launched = dist.is_available() and dist.is_torchelastic_launched()
    return not launched or os.environ.get("RANK", "0") == "0"


def wait() -> None:
    """Wait until all processes get here."""
    if size() > 1:
        dist.barrier()


def shard(environments: int) -> slice:
    """Return this process's environments; raise ValueError unless processes divide them evenly."""
    count = size()
    if environments % count:
        raise ValueError(f"{environments} environments are not divided among {count} processes")
    rank, each = dist.get_rank() if count > 1 else 0, environments // count
    return slice(rank * each, (rank + 1) * each)


def average(tensors: Sequence[Tensor]) -> None:
    """Replace each of `tensors`, of any shape, in place by its mean over the processes."""
    if size() == 1:
        return
    flat = torch.cat([x.flatten() for x in tensors])
    dist.all_reduce(flat)
    for x, mean in zip(tensors, (flat / size()).split([x.numel() for x in tensors]), strict=True):
        x.copy_(mean.view_as(x))


def gathered(x: Any) -> list[Any]:
    """Return the values of `x` in all processes."""
    if size() == 1:
        return [x]
    result: list[Any] = [None] * size()
    dist.all_gather_object(result, x)
    return result


def joined(x: np.ndarray, axis: int = 0) -> np.ndarray:
    """Concatenate the processes' arrays [n, ...], into a copy [N, ...] for all environments."""
    return np.concatenate(gathered(x), axis)
