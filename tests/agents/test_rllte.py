"""Modules that RLLTE pickles: read without importing their classes, and equal in what they say."""

import io
import struct
import sys
import zipfile
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import nn

from astray.agents.importers import pth, rllte

MODULE = "rllte.common.utils"


class Residual(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x):
        rectified = x.relu()
        return rectified + self.conv2(self.conv1(rectified).relu())


class Conv2d_tf(nn.Conv2d):  # as it is called there
    def __init__(self, *sizes):
        super().__init__(*sizes)
        self.padding = "SAME"

    def forward(self, x):
        return nn.functional.conv2d(x, self.weight, self.bias, padding=1)


class Layer(nn.Module):
    def __init__(self, before, after):
        super().__init__()
        parts = Residual(after), Residual(after)
        pool = nn.MaxPool2d(3, 2, 1)
        self.main = nn.Sequential(Conv2d_tf(before, after, 3), pool, *parts)

    def forward(self, x):
        return self.main(x)


class Encoder(nn.Module):
    def __init__(self, widths):
        super().__init__()
        layers = [Layer(a, b) for a, b in zip((3, *widths), widths, strict=False)]
        dense = nn.Linear(64 * widths[-1], 256)
        self.trunk = nn.Sequential(*layers, nn.Flatten(), dense, nn.ReLU())


class Actor(nn.Module):
    def __init__(self, actions):
        super().__init__()
        self.actor = nn.Linear(256, actions)


class ExportModel(nn.Module):
    def __init__(self, widths=(2, 3, 4), actions=15):
        super().__init__()
        self.encoder, self.actor = Encoder(widths), Actor(actions)

    def forward(self, images):
        planes = torch.as_tensor(images).permute(0, 3, 1, 2) / 255
        return self.actor.actor(self.encoder.trunk(planes))


@pytest.fixture
def saved(monkeypatch):
    """A function that saves modules as files of RLLTE, whose package is gone when they are read."""
    classes = Residual, Conv2d_tf, Layer, Encoder, Actor, ExportModel

    def save(model):
        with monkeypatch.context() as patch:
            package = ModuleType(MODULE)
            for kind in classes:
                patch.setattr(kind, "__module__", MODULE)
                setattr(package, kind.__name__, kind)
            for name in ("rllte", "rllte.common", MODULE):
                patch.setitem(sys.modules, name, package)
            torch.save(model, file := io.BytesIO())
        return file.getvalue()

    return save


def test_a_pickled_module_says_what_it_said_there(saved):
    torch.manual_seed(0)
    there = ExportModel()
    found = pth.read(saved(there))
    assert MODULE not in sys.modules, "the class is not there, nor needed"
    assert found.architecture.name == "impala-rectified" and found.architecture.widths == (2, 3, 4)
    images = np.random.default_rng(0).integers(0, 256, (5, 64, 64, 3), np.uint8)
    with torch.no_grad():
        logits, values = found.network(torch.from_numpy(images))
        assert logits.numpy() == pytest.approx(there(images).numpy(), abs=1e-5)
    assert values.abs().max() == 0 and "without a critic" in found.about


def replaced(index, module):
    """A change of a part of the first block."""
    return lambda model: model.encoder.trunk[0].main.__setitem__(index, module)


def noted(index, **settings):
    """A change of settings of such a part."""
    return lambda model: vars(model.encoder.trunk[0].main[index]).update(settings)


def changed(model, change):
    change(model)
    return model


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda m: setattr(m.encoder.trunk[0].main[2].relu, "inplace", False), "work in place"),
        (
            lambda m: m.encoder.trunk.__setitem__(5, nn.Tanh()),
            "trunk.5 is the module Tanh, which its netw",
        ),
        (
            lambda m: m.encoder.trunk[1].main.__setitem__(1, nn.AvgPool2d(3, 2, 1)),
            r"trunk\.1\.main\.1 is the module AvgPool2d, which its network does not have",
        ),
        (
            lambda m: m.encoder.trunk.__setitem__(5, nn.Identity()),
            r"trunk\.5 is the module Identity, which its network does not have",
        ),
        (
            replaced(0, nn.ConvTranspose2d(3, 2, 3)),
            r"trunk\.0\.main\.0 is the module ConvTranspose2d, which",
        ),
        (replaced(1, nn.MaxPool2d(5, 2, 2)), r"main\.1\.kernel_size is 5; in its network 3"),
        (replaced(1, nn.MaxPool2d(3, 2, 1, 2)), r"main\.1\.dilation is 2; in its network 1"),
        (noted(1, stride=1), r"main\.1\.stride is 1; in its network 2"),
        (noted(0, padding="VALID"), r"main\.0\.padding is 'VALID'; in its network \(1, 1\)"),
        (noted(0, dilation=(2, 2)), r"main\.0\.dilation is \(2, 2\); in its network \(1, 1\)"),
        (
            lambda m: setattr(m.encoder.trunk[2].main[3].conv2, "padding_mode", "circular"),
            r"conv2\.padding_mode is 'circular'; in its network zeros",
        ),
        (lambda m: setattr(m.actor, "actor", nn.Linear(256, 9)), "chooses from 9 actions"),
        (lambda m: setattr(m.encoder.trunk[4], "bias", None), "lacks features.linear.bias"),
        (lambda m: m.encoder.add_module("other", nn.Linear(2, 2)), "has encoder.other"),
        (lambda m: setattr(m.actor, "actor", nn.Sequential()), "no policy of one layer"),
        (
            lambda m: [setattr(m.encoder, f"w{k}", m.encoder.trunk[4].weight) for k in range(3)],
            "its weights are more than the file holds",
        ),
        (lambda m: m.double(), "other than numbers of 32 bits"),
        (
            lambda m: setattr(m.encoder.trunk[0].main[0], "weight", nn.Parameter(torch.ones(()))),
            r"block1.conv.weight is \(\); it would have 4",
        ),
    ],
)
def test_other_networks_are_refused_with_the_reason(saved, change, message):
    with pytest.raises(ValueError, match=message):
        pth.read(saved(changed(ExportModel(), change)))


def test_a_file_that_asks_for_more_runs_nothing(saved, tmp_path):
    class Evil:
        def __reduce__(self):
            return (open, (str(tmp_path / "made"), "w"))

    model = ExportModel()
    model.encoder.space = Evil()
    assert pth.read(saved(model)).architecture.widths == (2, 3, 4)
    assert not (tmp_path / "made").exists()


START = b"\x80\x02" + rllte.MARK


LONG_NAMES = b"X" + struct.pack("<I", 4000) + b"a" * 4000 + b"q\0" + b"h\0h\0\x93" * 120 + b"."
WIDE = (  # a tensor whose shape is all numbers that it has
    b"ctorch._utils\n_rebuild_tensor_v2\n((X\7\0\0\0storagectorch\nFloatStorage\n"
    b"X\1\0\0\0000X\3\0\0\0cpuKdtQq\1K\0h\1h\1tR."
)


def packed(method, **parts):
    with zipfile.ZipFile(file := io.BytesIO(), "w", method) as archive:
        for name, data in parts.items():
            archive.writestr(f"agent/{name.replace('_', '/')}", data)
    return file.getvalue()


def damaged(data, after, by):
    at = data.index(after) + len(after)
    return data[:at] + by + data[at + len(by) :]


@pytest.mark.parametrize(
    "file, message",
    [
        (packed(zipfile.ZIP_BZIP2, **{"data.pkl": bytes(1 << 20)}), "is compressed by"),
        (damaged(packed(zipfile.ZIP_LZMA, **{"data.pkl": START}), b".pkl", bytes(30)), "compress"),
        (damaged(packed(zipfile.ZIP_DEFLATED, **{"data.pkl": START}), b".pkl", b"\7"), "compress"),
        (packed(0, **{"data.pkl": START + LONG_NAMES}), "more than 100,000 parts"),
        (packed(0, **{"data.pkl": START + WIDE, "data_0": bytes(400)}), "where a tuple belongs"),
        (damaged(packed(0, **{"data.pkl": START}), b"PK\1\2", bytes(16) + b"\xff" * 8), "damaged"),
    ],
)
def test_a_compressed_or_damaged_archive_is_refused(file, message):
    with pytest.raises(ValueError, match=message):
        pth.read(file)


def text(said):
    return b"X" + struct.pack("<I", len(said)) + said.encode()


def module(parameters, modules):
    return (
        START[2:]
        + b")\x81}("
        + text("_parameters")
        + parameters
        + text("_modules")
        + modules
        + b"ub"
    )


MANY = b"}(" + b"".join(text(f"{k}") + b"N" for k in range(300)) + b"u"
SHARED = b"K\1" + b"q\0h\0\x86" * 30  # a tuple of itself twice, thirty times over


@pytest.mark.parametrize(
    "data, said",
    [
        (module(b"}", b"}" + text("a" * 10**5) + module(b"}", MANY) + b"s"), "or a long name"),
        (module(b"}", MANY), "more than 200 modules and parameters"),
        (module(MANY, b"}"), "more than 200 modules and parameters"),
        (
            START[2:] + b")\x81cnumpy\ndtype\ncown\nClass\n)\x81" + SHARED + b"b\x85R",
            "a Foreign where a str belongs",
        ),
    ],
    ids=["a long name", "modules", "parameters", "an object of shared tuples"],
)
def test_names_and_objects_that_a_file_shares_are_not_written_out(data, said):
    """A name of 100,000 letters before each of 20,000 others took 2 GB."""
    with pytest.raises(ValueError, match=said):
        pth.read(packed(0, **{"data.pkl": b"\x80\2" + data + b"."}))


def test_numbers_of_the_other_byte_order_are_refused(saved):
    with zipfile.ZipFile(file := io.BytesIO(saved(ExportModel()))) as archive:
        parts = {one: archive.read(one) for one in archive.namelist()}
    (order,) = (one for one in parts if one.endswith("byteorder"))
    with zipfile.ZipFile(file := io.BytesIO(), "w") as archive:
        for name, data in (parts | {order: b"big"}).items():
            archive.writestr(name, data)
    with pytest.raises(ValueError, match="begin with their largest part"):
        pth.read(file.getvalue())


def test_numbers_that_a_pickle_asks_for_again_are_read_once():
    name = b"ctorch\nFloatStorage\n"
    asked = b"(" + text("storage") + name + text("0") + text("cpu") + b"K\1tQ"
    one, other = rllte._root(
        packed(0, **{"data.pkl": b"\x80\2" + asked * 2 + b"\x86.", "data_0": bytes(8)})
    )
    assert np.shares_memory(one, other)
