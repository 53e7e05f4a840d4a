"""Agents of others, read from files that are made here in their formats; and hostile files."""

import io
import os
import pickle
import struct
import zipfile

import msgpack
import numpy as np
import pytest
import torch

from astray.agents.clear import Clear
from astray.agents.impala import Impala, SamePool
from astray.agents.importers import cleanrl, files, jd, plain, pth
from astray.agents.policy import Architecture, load, weights
from helpers.foreign import as_pfrl, clarity, cleanba, flax_bytes, joblib_bytes, reference, saved

SHAPE = (64, 64, 3)
IMAGES = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (3, *SHAPE), np.uint8))


def naive(params, image):
    """Logits and value as the published description computes them, rows, columns, channels."""
    x = image.astype(np.float64) / 255

    def convolve(x, name):
        kernel = params[f"ppo2_model/pi/{name}/conv2d/kernel:0"]
        pad = len(kernel) // 2
        padded = np.pad(x, ((pad, pad), (pad, pad), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape[:2], (0, 1))
        out = np.einsum("yxcij,ijco->yxo", windows, kernel, optimize=True)
        return np.maximum(out + params[f"ppo2_model/pi/{name}/conv2d/bias:0"], 0)

    def pool(x):
        height, width, channels = x.shape
        squares = (x**2).reshape(height // 2, 2, width // 2, 2, channels)
        return np.sqrt(squares.mean((1, 3)) + 1e-8)

    for names in (["1a"], ["2a", "2b"], ["3a"], ["4a"]):
        for name in names:
            x = convolve(x, name)
        x = pool(x)
    x = x.reshape(-1)
    for name in ("dense", "dense_1"):
        kernel, bias = (params[f"ppo2_model/pi/{name}/{part}:0"] for part in ("kernel", "bias"))
        x = np.maximum(x @ kernel + bias, 0)
    heads = [
        x @ params[f"ppo2_model/{h}/w:0"] + params[f"ppo2_model/{h}/b:0"] for h in ("pi", "vf")
    ]
    return heads[0], heads[1][0]


def test_a_clear_network_computes_what_its_description_says():
    data, params = clarity()
    found = jd.read(joblib_bytes(data))
    with torch.no_grad():
        logits, values = found.network(IMAGES)
    for image, some_logits, value in zip(IMAGES.numpy(), logits, values, strict=True):
        expected = naive(params, image)
        assert np.allclose(some_logits, expected[0], atol=1e-4)
        assert value == pytest.approx(expected[1], abs=1e-4)


def test_a_file_of_rl_clarity_tells_what_it_was_trained_on():
    found = jd.read(joblib_bytes(clarity(gamma=0.99, num_envs=8, num_levels=None)[0]))
    assert found.world == ("coinrun", "hard")
    assert found.settings == {"gamma": 0.99, "num_envs": 8}
    assert found.told["cnn"] == "clear"


def test_a_setting_of_zero_is_told_and_no_levels_are_all_of_them():
    found = jd.read(joblib_bytes(clarity(entropy_coeff=0.0, num_levels=0, start_level=0)[0]))
    assert found.settings == {"gamma": 0.999, "entropy_weight": 0.0, "first_level": 0}


def test_every_activation_of_the_clear_network_is_named():
    names = {
        name for name, module in Clear(SHAPE, 15).named_modules() if not list(module.children())
    }
    assert names == {
        "block1.conv1", "block1.relu1", "block1.pool",
        "block2.conv1", "block2.relu1", "block2.conv2", "block2.relu2", "block2.pool",
        "block3.conv1", "block3.relu1", "block3.pool", "block4.conv1", "block4.relu1",
        "block4.pool", "features.flatten", "features.linear1", "features.relu1",
        "features.linear2", "features.relu2", "policy", "value",
    }  # fmt: skip


@pytest.mark.parametrize(
    "widths, wrap",
    [
        ((16, 32, 32), lambda state: {"state_dict": state}),
        (
            (64, 128, 128),
            lambda state: {"model_state_dict": state, "optimizer_state_dict": {"state": {}}},
        ),
        ((8, 24, 40), lambda state: state),
        ((16, 32, 32), as_pfrl),
    ],
)
def test_impala_of_any_widths_computes_what_it_did_there(widths, wrap):
    state, forward = reference(widths)
    found = pth.read(saved(wrap(state)))
    assert found.architecture.widths == widths
    with torch.no_grad():
        for ours, theirs in zip(found.network(IMAGES), forward(IMAGES), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("widths", [(16, 32, 32), (2, 3, 4)])
def test_an_agent_of_cleanba_computes_what_it_did_there(widths):
    data, forward = cleanba(widths)
    found = cleanrl.read(data)
    with torch.no_grad():
        ours = found.network(IMAGES)
    for some, theirs in zip(ours, forward(IMAGES.numpy()), strict=True):
        np.testing.assert_allclose(some, theirs, rtol=1e-4, atol=1e-4)
    assert found.world == ("coinrun", "hard") and found.settings == {"gamma": 0.999, "seed": 1}


def test_pools_of_uneven_sides_are_padded_on_both():
    x = torch.arange(25.0).reshape(1, 1, 5, 5)
    assert SamePool()(x).flatten().tolist() == [6, 8, 9, 16, 18, 19, 21, 23, 24]


def other(module, *path, weights):
    """A file of cleanba with other weights in one place."""
    data = msgpack.unpackb(cleanba((2, 2, 2))[0], ext_hook=msgpack.ExtType)
    *ways, last = path
    there = data["1"][module]["params"]
    for way in ways:
        there = there[way]
    there[last] = weights
    return flax_bytes(data)


@pytest.mark.parametrize(
    "data, why",
    [
        (b"\xc1", "damaged, or no msgpack"),
        (b"\x93\x01", "damaged, or no msgpack"),
        (b"\x91" * 5000, "damaged, or no msgpack"),
        (flax_bytes({"0": {}, "1": {}}), "no settings and three modules"),
        (flax_bytes({"0": {}, "1": {"0": {}, "1": {}, "2": {}}}), "without parameters"),
        (msgpack.packb(msgpack.ExtType(7, b"")), "the extension 7"),
        (msgpack.packb(msgpack.ExtType(1, msgpack.packb(((1,), "object", b"")))), "'object'"),
        (msgpack.packb(msgpack.ExtType(1, msgpack.packb(((9,), "uint8", b"")))), "damaged"),
        (cleanba((2, 2, 2), actions=9)[0], "chooses from 9 actions"),
        (other("1", "Dense_0", "bias", weights=np.float32(1)), "chooses from 0 actions"),
        (other("1", "Dense_0", "bias", weights=np.full(15, 1e300)), "not all finite"),
        (other("0", "ConvSequence_0", "Conv_0", "kernel", weights=np.empty((0, 3, 3, 2**33), "f4")),
         "as wide as"),
        (b"\x82\xa10\x80\xa11\x83\xa10\x81\xa6params" + b"\x81\xa1a" * 1000
         + b"\x01\xa11\x80\xa12\x80", "without parameters"),
        (cleanba((2, 2, 2))[0].replace(b"ConvSequence_2", b"ConvSequence_3"), "does not"),
        (cleanba((2, 2, 2))[0].replace(b"ResidualBlock_1", b"ResidualBlock_0"), "lacks"),
    ],
)  # fmt: skip
def test_what_is_no_agent_of_cleanba_is_refused(data, why):
    with pytest.raises(ValueError, match=why):
        cleanrl.read(data)


def archived(data, compression=zipfile.ZIP_STORED):
    """A file of torch with this pickle in it."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, text in (("data.pkl", data), ("version", b"3\n"), ("byteorder", b"little")):
            archive.writestr(f"archive/{name}", text)
    return file.getvalue()


def doubled(depth, zipped):
    """A file whose dictionary has a key of `depth` tuples, each of the last one twice."""
    pairs = [b"h" + bytes([i]) + b"\x86q" + bytes([i + 1]) for i in range(1, depth + 1)]
    data = b"\x80\x02}q\x00K\x01\x85q\x01" + b"".join(pairs) + b"K\x01s."
    return archived(data) if zipped else data


@pytest.mark.parametrize("zipped", [True, False])
def test_a_key_of_shared_tuples_is_refused_before_it_is_hashed(zipped):
    assert pickle.loads(doubled(10, zipped=False))  # it is a pickle; of 60 it would take years
    with pytest.raises(ValueError, match="the same tuple many times"):
        pth.read(doubled(60, zipped))


@pytest.mark.parametrize("old", [True, False])
def test_files_with_an_optimizer_share_no_tuples(old):
    network = torch.nn.Linear(3, 3)
    optimizer = torch.optim.Adam(network.parameters())
    network(torch.ones(3)).sum().backward()
    optimizer.step()
    file = io.BytesIO()
    held = {"state_dict": network.state_dict(), "optimizer_state_dict": optimizer.state_dict()}
    torch.save(held, file, _use_new_zipfile_serialization=not old)
    pth.check_plain(file.getvalue())


def test_channels_of_any_widths_are_kept_with_the_weights(tmp_path):
    architecture = Architecture("impala", SHAPE, (), 15, widths=(8, 24, 40))
    network = architecture.build()
    assert isinstance(network, Impala) and network.block3.conv.out_channels == 40
    (tmp_path / "agent").write_bytes(weights(network, architecture, "maze"))
    again, found = load(tmp_path / "agent", "maze")
    assert found == architecture
    assert torch.equal(again(IMAGES)[0], network(IMAGES)[0])


def changed(**changes):
    state = reference((16, 32, 32))[0]
    for name, value in changes.items():
        state[name.replace("__", ".")] = value
    return saved({k: v for k, v in state.items() if v is not None})


class Runs:
    """Runs a command where it is unpickled."""

    def __reduce__(self):
        return os.system, ("echo ran >> /dev/null",)


BYTEARRAY = (
    b"\x80\x02c__builtin__\nbytearray\n\x8a\x04\x00\xe4\x0b\x04\x85R."  # of 68 million bytes
)
DEEP = b"\x80\x02})" + b"\x85" * 15_000 + b"K\x01s."
HUGE = torch.zeros(1).expand(2**40, 256)

REFUSED_PTH = {
    "a command": (lambda: saved({"state_dict": Runs()}), "more than weights.*for posix.system"),
    "a plain pickle": (lambda: pickle.dumps(Runs(), 2), "nothing in a file is run"),
    "nothing": (lambda: b"", "damaged, or no file of torch"),
    "half a file": (lambda: changed()[:5000], "damaged, or no file of torch"),
    "a list": (lambda: saved([1, 2]), "holds a list, not weights by name"),
    "no weights": (lambda: saved({"steps": 5}), "holds 'steps', which is no weight"),
    "another network": (lambda: saved({"conv.weight": torch.zeros(3)}), "no IMPALA of train-procg"),
    "a memory": (lambda: changed(gru__weight=torch.zeros(3)), "recurrent agent"),
    "9 actions": (lambda: changed(fc_policy__weight=torch.zeros(9, 256)), "9 actions, of CoinRun"),
    "16 actions": (lambda: changed(fc_policy__weight=torch.zeros(16, 256)), "from 16 actions; Pro"),
    "a layer less": (lambda: changed(fc_value__bias=None), "lacks value.bias"),
    "a layer more": (lambda: changed(more=torch.zeros(3)), "has more, which its network does not"),
    "another size": (lambda: changed(embedder__fc__weight=torch.zeros(256, 9)), "it would be"),
    "no number": (lambda: changed(fc_value__bias=torch.full((1,), torch.nan)), "not all finite"),
    "a whole number": (lambda: changed(fc_value__bias=torch.ones(1, dtype=int)), "not all finite"),
    "more than the file": (lambda: changed(embedder__fc__weight=HUGE), "more than the file holds"),
    "no dimension": (lambda: changed(fc_policy__weight=torch.tensor(1.0)), "from 0 actions"),
    "no number in 32 bits": (
        lambda: changed(fc_value__bias=torch.full((1,), 1e300, dtype=torch.float64)),
        "not all finite"),
    "a width without numbers": (
        lambda: changed(embedder__block1__conv__weight=torch.empty(2**33, 0, 3, 3)), "as wide as"),
    "a layer twice": (lambda: saved({**reference((2, 2, 2))[0], "policy.bias": torch.ones(15)}),
                      "two weights of the same layer"),
    "sparse weights": (lambda: changed(fc_value__bias=torch.zeros(1).to_sparse()), "more than w"),
    "no memory": (lambda: changed(fc_value__bias=torch.zeros(1, device="meta")), "more than weig"),
    "eight bits": (
        lambda: changed(fc_value__bias=torch.zeros(1).to(torch.float8_e4m3fn)), "more than w"),
    "a wide bytearray": (lambda: archived(BYTEARRAY), "asks for __builtin__.bytearray"),
    "a wide bytearray, as of old": (lambda: BYTEARRAY, "asks for __builtin__.bytearray"),
    "deep tuples as a key": (lambda: archived(DEEP), "more than 10,000 tuples"),
    "deep tuples as a key, as of old": (lambda: DEEP, "more than 10,000 tuples"),
    "a compressed pickle": (lambda: archived(BYTEARRAY, zipfile.ZIP_BZIP2), "it is compressed"),
    "compressed weights": (lambda: archived(b"\x80\x02}.", zipfile.ZIP_DEFLATED), "compressed"),
    "a wrong checksum": (
        lambda: archived(BYTEARRAY).replace(BYTEARRAY, BYTEARRAY[:-1] + b" "), "is damaged, or no"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED_PTH)
def test_a_pth_that_is_refused_says_why(name):
    make, said = REFUSED_PTH[name]
    with pytest.raises(ValueError, match=f"(?s){said}"):
        pth.read(make())


def wrong(name, shape):
    data, _ = clarity()
    data["params"][f"ppo2_model/{name}:0"] = np.zeros(shape, np.float32)
    return joblib_bytes(data)


def without(part, name):
    data, _ = clarity()
    del data[part][name]
    return joblib_bytes(data)


VALUE = "ppo2_model/vf/b:0"
REFUSED_JD = {
    "no weights": (lambda: joblib_bytes({"args": {}}), "no args and params"),
    "an LSTM": (lambda: joblib_bytes(clarity(use_lstm=1)[0]), "recurrent"),
    "another network": (lambda: joblib_bytes(clarity(cnn="impala")[0]), "network is 'impala'"),
    "7 actions": (lambda: joblib_bytes(clarity(7)[0]), "7 actions, of CoinRun as it was before"),
    "a layer less": (lambda: without("params", VALUE), "lacks value.bias"),
    "a layer more": (
        lambda: joblib_bytes({"args": {}, "params": {"ppo2_model/pi/5a/w:0": np.zeros(3)}}),
        "which the clear network does not",
    ),
    "no array": (lambda: joblib_bytes({"args": {}, "params": {"a": 3}}), "'a', which is no array"),
    "no dimension": (lambda: wrong("pi/b", ()), "chooses from 0 actions"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED_JD)
def test_a_jd_that_is_refused_says_why(name):
    make, said = REFUSED_JD[name]
    with pytest.raises(ValueError, match=said):
        jd.read(make())


PLAIN = [
    {"a": [1, -2, 3.5, None, True, "text", b"bytes"], "b": ((), (1,), (1, 2), (1, 2, 3), (1,) * 4)},
    {
        "large": 2**70,
        "long": "x" * 300,
        "many": list(range(3000)),
        "keys": {k: k for k in range(9)},
    },
]


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("data", PLAIN)
def test_plain_data_comes_out_as_it_went_in(data, protocol):
    assert plain.read(pickle.dumps(data, protocol)) == data


@pytest.mark.parametrize("alignment", [None, 16])
@pytest.mark.parametrize(
    "array",
    [
        np.arange(6, dtype="<f4").reshape(2, 3),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(4, dtype=">i2"),
        np.zeros((0, 3)),
        np.array(3.0),
        np.array([True]),
    ],
)
def test_arrays_come_out_as_they_went_in(array, alignment):
    found = plain.read(joblib_bytes({"before": 1, "x": array, "after": array}, alignment))
    assert found["before"] == 1
    for name in ("x", "after"):
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)


def global_(name, rest=b"."):
    module, _, attribute = name.rpartition(".")
    return b"\x80\x03c" + f"{module}\n{attribute}\n".encode() + rest


def described(**changes):
    """A file with one array of a false description."""
    file = io.BytesIO()
    pickler = pickle._Pickler(file, 3)
    pickler.proto = 3
    file.write(b"\x80\x03cjoblib.numpy_pickle\nNumpyArrayWrapper\n)\x81")
    state = {"subclass": np.ndarray, "shape": (2,), "order": "C", "dtype": np.dtype("f4")}
    pickler.save(state | changes)
    return file.getvalue() + b"b" + bytes(8) + b"."


# Instructions of a tuple of itself twice, thirty times over: a billion numbers in 130 bytes.
SHARED = b"K\x01" + b"q\x00h\x00\x86" * 30

LATIN = b"X\x06\x00\x00\x00latin1"


def shared():
    """The same tuple."""
    value = 1
    for _ in range(30):
        value = (value, value)
    return value


HOSTILE = {
    "a command": (pickle.dumps(Runs(), 3), "posix.system|nt.system"),
    "a command, later protocol": (pickle.dumps(Runs(), 5), "posix.system|nt.system"),
    "a command, oldest protocol": (pickle.dumps(Runs(), 0), "posix.system|nt.system"),
    "a command by INST": (b"(S'echo'\nios\nsystem\n.", "instruction STRING"),
    "a command by INST alone": (b"(ios\nsystem\n.", "instruction INST"),
    "a command by OBJ": (b"(cos\nsystem\no.", "asks for os.system"),
    "eval": (global_("builtins.eval"), "asks for builtins.eval"),
    "getattr": (global_("builtins.getattr"), "asks for builtins.getattr"),
    "numpy's loader": (global_("numpy.load"), "asks for numpy.load"),
    "a name that is a path": (global_("joblib.numpy_pickle.load"), "asks for joblib.numpy_pickle"),
    "a call of an array's class": (global_("numpy.ndarray", b"K\x05\x85R."), "calls 'numpy"),
    "a call of a list": (global_("builtins.list", b")R."), "calls 'builtins list'"),
    "a call of data": (b"\x80\x03X\x01\x00\x00\x00a)R.", "calls 'a'"),
    "an object of another class": (global_("builtins.list", b")\x81."), "makes an object of"),
    "attributes of a dict": (b"\x80\x03}}b.", "sets what is inside a dict"),
    "an extension": (b"\x80\x03\x82\x01.", "instruction EXT1"),
    "a persistent id": (b"\x80\x03K\x01Q.", "instruction BINPERSID"),
    "a bytearray": (b"\x80\x05\x96" + struct.pack("<Q", 1 << 60) + b".", "damaged"),
    "an array of objects": (described(dtype=np.dtype("O")), "array of 'O8'|only arrays of numbers"),
    "an array of text": (described(dtype=np.dtype("U4")), "only arrays of numbers"),
    "a class of its own": (described(subclass=dict), "asks for builtins|array of the class"),
    "a larger array than the file": (described(shape=(2**50,)), "beyond the end of the file"),
    "a negative array": (described(shape=(-1,)), r"shape is \(-1,\)"),
    "a shape of text": (described(shape="ab"), "shape is 'ab'"),
    "an entry in a list": (b"\x80\x03]K\x01K\x02s.", "a list where a dict belongs"),
    "more in a number": (b"\x80\x03K\x05K\x01a.", "a int where a list belongs"),
    "a key of a list": (b"\x80\x03}]K\x01s.", "a list is a key of a dict"),
    "shared tuples as a key": (b"\x80\x03}" + SHARED + b"K\x01s.", "a tuple is a key of a dict"),
    "shared tuples as keys": (b"\x80\x03}(" + SHARED + b"K\x01u.", "a tuple is a key of a dict"),
    "shared tuples as a key of a call": (
        b"\x80\x03ccollections\nOrderedDict\n](" + SHARED + b"K\x01\x86e\x85R.",
        "a tuple is a key of a dict"),
    "a call of shared tuples": (b"\x80\x03" + SHARED + b")R.", r"it calls \(\(\("),
    "an object of shared tuples": (b"\x80\x03" + SHARED + b")\x81.", r"makes an object of \(\("),
    "shared tuples encoded": (
        b"\x80\x03c_codecs\nencode\n" + SHARED + LATIN + b"\x86R.",
        "a tuple where a str belongs"),
    "a name of shared tuples": (b"\x80\x04" + 2 * SHARED + b"\x93.", "a tuple where a str belongs"),
    "numbers of shared tuples": (
        b"\x80\x03cnumpy\ndtype\n" + SHARED + b"\x85R.", r"a type of numbers is \(\("),
    "a shape of shared tuples": (described(shape=shared()), r"shape is \(\("),
    "a class of shared tuples": (described(subclass=shared()), r"array of the class \(\("),
    "an integer of a million digits": (
        b"\x80\x03\x8b" + struct.pack("<i", 500_000) + b"\x7f" * 500_000 + b".",
        "an integer of 3,999,999 bits"),
    "a million lists": (b"\x80\x03(" + b"]" * 1_000_000 + b"l.", "more than 100,000 parts"),
    "a list of pairs many times": (
        b"\x80\x03](" + b"X\x01\x00\x00\x00aK\x01\x86" * 9000 + b"e\x85q\x00"
        b"ccollections\nOrderedDict\nq\x01" + b"h\x01h\x00R" * 9000 + b".",
        "more than 100,000 parts"),
    "a text encoded many times": (
        b"\x80\x03X" + struct.pack("<I", 10**6) + b"a" * 10**6 + LATIN + b"\x86q\x00"
        b"c_codecs\nencode\nq\x01" + b"h\x01h\x00R" * 9000 + b".", "more than 100,000 parts"),
    "a memory that is empty": (b"\x80\x03h\x05.", "damaged"),
    "a mark that is not there": (b"\x80\x03t.", "damaged"),
    "nothing on the stack": (b"\x80\x03.", "damaged"),
    "no end": (b"\x80\x03K\x01", "damaged"),
    "nothing": (b"", "damaged"),
    "text": (b"hello, world", "damaged|instruction"),
    "a compressed file": (b"x\x9c" + bytes(20), "damaged"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_and_nothing_in_it_runs(name, monkeypatch):
    data, said = HOSTILE[name]
    monkeypatch.setattr(os, "system", lambda command: pytest.fail(f"{command} was run"))
    with pytest.raises(ValueError, match=said):
        plain.read(data)


def test_a_setting_of_shared_tuples_is_written_in_part():
    data = b"\x80\x03}(X\x04\x00\x00\x00args}X\x03\x00\x00\x00cnn" + SHARED
    data += b"sX\x06\x00\x00\x00params}u."
    with pytest.raises(ValueError, match=r"its network is \(\(\(.*\.\.\."):
        jd.read(data)


def test_a_file_cannot_fill_the_memory_with_its_own_numbering():
    """Python's own machine makes a table of 2**31 entries for this; ours a dict of one."""
    assert plain.read(b"\x80\x03K\x07r\xff\xff\xff\x7f.") == 7


def test_a_thousand_spoilt_files_are_refused_or_read():
    whole = bytearray(joblib_bytes({"args": {"a": 1}, "params": {"x": np.arange(5.0)}}))
    random, refused = np.random.default_rng(0), 0
    for _ in range(1000):
        spoilt = whole.copy()
        for place in random.integers(0, len(whole), 3):
            spoilt[place] = random.integers(256)
        try:
            plain.read(bytes(spoilt))
        except ValueError:
            refused += 1
    assert 100 < refused < 1000


def test_a_file_of_another_kind_or_size_is_refused(tmp_path, monkeypatch):
    with pytest.raises(
        ValueError, match=r"an agent's file is \.pth, \.pt, \.jd, \.cleanrl_model; got \.zip"
    ):
        files.read(tmp_path / "agent.zip")
    (tmp_path / "agent.jd").write_bytes(bytes(20))
    monkeypatch.setattr(files, "LARGEST", 10)
    with pytest.raises(ValueError, match="must be of at most 10 bytes; it has 20"):
        files.read(tmp_path / "agent.jd")
