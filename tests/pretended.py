"""A CUDA device that is not there: the processor computes, and what CUDA would not allow fails.

Whoever touches memory before an event says that a copy is done finds what a device that is late
leaves there. A graph does again what was done while it was captured, with the same memory and the
same numbers; capturing it changes nothing, and may neither wait, nor draw, nor read a number.
"""

from __future__ import annotations

import contextlib

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from astray.agents import policy

# What waits for the device, copies a number to it, or draws from a generator.
FORBIDDEN = ("_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "rand", "bernoulli")


class Device(TorchFunctionMode):
    """Tensors on "cuda" are made on the CPU; copies to and from pinned memory are done late."""

    def __init__(self):
        super().__init__()
        self.pinned: set[int] = set()  # where storages begin
        self.under_way: list[tuple[Tensor, Tensor, Tensor]] = []  # to, from, what was sent
        self.graphs: list[Graph] = []

    def __torch_function__(self, function, types, args=(), kwargs=None):
        kwargs = {k: _here(v) if k == "device" else v for k, v in (kwargs or {}).items()}
        pin = kwargs.pop("pin_memory", False)
        if function is Tensor.copy_ and kwargs.pop("non_blocking", False):
            return self._copy(*args)
        if function is Tensor.to:
            args = tuple(map(_here, args))
        result = function(*args, **kwargs)
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


def _here(x):
    return "cpu" if isinstance(x, str | torch.device) and torch.device(x).type == "cuda" else x


@contextlib.contextmanager
def cuda(monkeypatch):
    """A device "cuda" that is pretended as long as this lasts."""
    device, generator = Device(), torch.Generator
    # Classes, since modules that are imported meanwhile have them in annotations.
    made = {"__new__": lambda cls, name: generator(_here(name))}
    with monkeypatch.context() as patch, device:
        patch.setattr(policy, "usable", lambda name: True)
        patch.setattr(torch, "Generator", type("Generator", (), made))
        patch.setattr(torch.cuda, "Event", type("Event", (Event,), {"device": device}))
        patch.setattr(torch.cuda, "Stream", Stream)
        patch.setattr(torch.cuda, "current_stream", Stream)
        patch.setattr(torch.cuda, "stream", lambda stream: contextlib.nullcontext())
        patch.setattr(torch.cuda, "CUDAGraph", type("Graph", (Graph,), {"device": device}))
        patch.setattr(torch.cuda, "graph", Capture)
        patch.setattr(torch.cuda, "synchronize", lambda: device.arrive(len(device.under_way)))
        yield device
