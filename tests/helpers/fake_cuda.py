"""A CUDA device that is not there: the processor computes, and what CUDA would not allow fails.

Memory of the processor and of the device do not meet in an operation, but for copies.
Whoever touches memory before an event says that a copy is done finds what a device that is late
leaves there. A graph does again what was done while it was captured, with the same memory and the
same numbers; capturing it changes nothing, and may neither wait, nor draw, nor read a number.
"""

from __future__ import annotations

import contextlib

import torch
from torch import Tensor
from torch.multiprocessing.reductions import StorageWeakRef
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from astray.agents import policy

MIXED = ("copy_", "index", "index_put_")  # copies; and indices may be the processor's
# What waits for the device, copies a number to it, or draws from a generator.
FORBIDDEN = ("_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "rand", "bernoulli")


class Memory(TorchDispatchMode):
    """Knows which tensors are the device's: those made there, and what is computed from them."""

    def __init__(self):
        super().__init__()
        self.storages: dict[int, StorageWeakRef] = {}

    def has(self, x: Tensor) -> bool:
        kept = self.storages.get(x.untyped_storage()._cdata)
        return kept is not None and not kept.expired()

    def take(self, results) -> None:
        for x in tree_leaves(results):
            if isinstance(x, Tensor):
                storage = x.untyped_storage()
                self.storages[storage._cdata] = StorageWeakRef(storage)

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name, kwargs = function._schema.name.removeprefix("aten::"), kwargs or {}
        given = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
        results = function(*args, **kwargs)
        if name not in MIXED and any(map(self.has, given)):
            assert all(self.has(x) or not x.dim() for x in given), f"{name} on two devices"
            self.take(results)
        elif name == "index" and self.has(given[0]):
            self.take(results)
        return results


class Device(TorchFunctionMode):
    """Tensors on "cuda" are made on the CPU; copies to and from pinned memory are done late."""

    def __init__(self):
        super().__init__()
        self.memory = Memory()
        self.pinned: set[int] = set()  # where storages begin
        self.under_way: list[tuple[Tensor, Tensor, Tensor]] = []  # to, from, what was sent
        self.graphs: list[Graph] = []

    def __torch_function__(self, function, types, args=(), kwargs=None):
        if getattr(function, "__self__", None) is Tensor.device and self.memory.has(args[0]):
            return torch.device("cuda")
        kwargs = dict(kwargs or {})
        pin, there = kwargs.pop("pin_memory", False), _there(kwargs.get("device"))
        if function is Tensor.copy_ and kwargs.pop("non_blocking", False):
            return self._copy(*args)
        if function is Tensor.to and any(map(_there, args)):
            there, args = True, [_here(x) for x in args]
            args[0] = args[0] if self.memory.has(args[0]) else args[0].clone()
        if function is Tensor.numpy:
            assert kwargs.get("force") or not self.memory.has(args[0]), (
                "it is not in numpy's memory"
            )
        if there:
            kwargs = {k: _here(x) if k == "device" else x for k, x in kwargs.items()}
        result = function(*args, **kwargs)
        if there:
            self.memory.take(result)
        elif function is Tensor.cpu or (function is Tensor.to and any(map(_left, args))):
            with torch._C._DisableTorchDispatch():  # a copy in the processor's memory
                result = result.clone()
        if pin:
            self.pinned.add(result.untyped_storage().data_ptr())
        return result

    def _copy(self, to: Tensor, source: Tensor) -> Tensor:
        assert to.is_contiguous() and source.is_contiguous() and to.dtype == source.dtype
        self.under_way.append((to, source, source.clone()))
        if to.untyped_storage().data_ptr() in self.pinned:
            return to.fill_(-1)
        assert source.untyped_storage().data_ptr() in self.pinned
        return to.copy_(source)

    def arrive(self, count: int) -> None:
        """The first `count` copies that are under way are done."""
        for to, source, sent in self.under_way[:count]:
            if to.untyped_storage().data_ptr() in self.pinned:
                to.copy_(sent)
            else:
                assert torch.equal(source, sent), "overwritten while it was copied"
        del self.under_way[:count]


class Event:
    """All that was under way when it was recorded is done."""

    device: Device

    def record(self) -> None:
        self.last = self.device.under_way[-1] if self.device.under_way else None

    def synchronize(self) -> None:
        assert hasattr(self, "last"), "it was never recorded"
        places = [k for k, copy in enumerate(self.device.under_way) if copy is self.last]
        self.device.arrive(places[0] + 1 if places else 0)


class Stream:
    def wait_stream(self, other: Stream) -> None:
        pass


class Graph:
    """What was computed while it was captured."""

    device: Device

    def __init__(self):
        self.calls: list = []
        self.device.graphs.append(self)

    @torch.no_grad()
    def replay(self) -> None:
        assert self.calls, "it was reset"
        for function, args, kwargs, results in self.calls:
            again = tree_leaves(function(*args, **kwargs))
            for kept, x in zip(results, again, strict=True):
                if isinstance(kept, Tensor) and kept.data_ptr() != x.data_ptr():
                    kept.copy_(x)

    def reset(self) -> None:
        self.calls = []


class Capture(TorchDispatchMode):
    """Notes the calls of torch for a graph; at the end nothing has been computed."""

    def __init__(self, graph: Graph):
        super().__init__()
        self.graph, self.before = graph, {}

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name, kwargs = function._schema.name.removeprefix("aten::"), kwargs or {}
        assert not name.startswith(FORBIDDEN), f"{name} while a graph is captured"
        for argument, x in zip(function._schema.arguments, args, strict=False):
            if argument.is_write:
                for changed in tree_leaves(x):
                    self.before.setdefault(id(changed), (changed, changed.clone()))
        results = function(*args, **kwargs)
        self.graph.calls.append((function, args, kwargs, tree_leaves(results)))
        return results

    def __exit__(self, *error):
        super().__exit__(*error)
        with torch.no_grad():
            for changed, before in self.before.values():
                changed.copy_(before)


def _there(x) -> bool:
    return isinstance(x, str | torch.device) and torch.device(x).type == "cuda"


def _left(x) -> bool:
    return isinstance(x, str) and x == "cpu"  # a torch.device is torch's own, of what is pretended


def _here(x):
    return "cpu" if _there(x) else x


@contextlib.contextmanager
def cuda(monkeypatch):
    """A device "cuda" that is pretended as long as this lasts."""
    device, generator, autocast = Device(), torch.Generator, torch.autocast
    # Classes, since modules that are imported meanwhile have them in annotations.
    made = {"__new__": lambda cls, name: generator(_here(name))}
    with monkeypatch.context() as patch, device, device.memory:
        patch.setattr(policy, "usable", lambda name: True)
        patch.setattr(torch, "Generator", type("Generator", (), made))
        patch.setattr(torch, "autocast", lambda name, *how, **more: autocast("cpu", *how, **more))
        patch.setattr(torch.cuda, "Event", type("Event", (Event,), {"device": device}))
        patch.setattr(torch.cuda, "Stream", Stream)
        patch.setattr(torch.cuda, "current_stream", Stream)
        patch.setattr(torch.cuda, "stream", lambda stream: contextlib.nullcontext())
        patch.setattr(torch.cuda, "CUDAGraph", type("Graph", (Graph,), {"device": device}))
        patch.setattr(torch.cuda, "graph", Capture)
        patch.setattr(torch.cuda, "synchronize", lambda: device.arrive(len(device.under_way)))
        yield device
