"""Plain data in pickles of others, and hostile files, of which nothing is run."""

import io
import os
import pickle
import struct
import time

import numpy as np
import pytest

from astray.agents.importers import jd, plain
from helpers.foreign import Runs, joblib_bytes

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
        assert found[name].dtype == array.dtype.newbyteorder("=")  # of which torch takes no other
        assert np.array_equal(found[name], array)


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
    "a negative array": (described(shape=(-1,)), r"shape must be a tuple of integers; got \(-1,\)"),
    "a shape of text": (described(shape="ab"), "shape must be a tuple of integers; got 'ab'"),
    "an entry in a list": (b"\x80\x03]K\x01K\x02s.", "a list where a dict belongs"),
    "more in a number": (b"\x80\x03K\x05K\x01a.", "a int where a list belongs"),
    "a key of a list": (b"\x80\x03}]K\x01s.", "a list is a key of a dict"),
    "shared tuples as a key": (b"\x80\x03}" + SHARED + b"K\x01s.", "a tuple is a key of a dict"),
    "shared tuples as keys": (b"\x80\x03}(" + SHARED + b"K\x01u.", "a tuple is a key of a dict"),
    "shared tuples as a key of a call": (
        b"\x80\x03ccollections\nOrderedDict\n](" + SHARED + b"K\x01\x86e\x85R.",
        "a tuple is a key of a dict"),
    "integers of one hash as keys": (
        b"\x80\x03}(" + b"".join(b"\x8a\x0a" + (k * (2**61 - 1)).to_bytes(10, "little") + b"N"
                                for k in range(1, 3000)) + b"u.", "a int is a key of a dict"),
    "a call of shared tuples": (b"\x80\x03" + SHARED + b")R.", r"it calls \(\(\("),
    "an object of shared tuples": (b"\x80\x03" + SHARED + b")\x81.", r"makes an object of \(\("),
    "shared tuples encoded": (
        b"\x80\x03c_codecs\nencode\n" + SHARED + LATIN + b"\x86R.",
        "a tuple where a str belongs"),
    "a name of shared tuples": (b"\x80\x04" + 2 * SHARED + b"\x93.", "a tuple where a str belongs"),
    "numbers of shared tuples": (
        b"\x80\x03cnumpy\ndtype\n" + SHARED + b"\x85R.", "a tuple where a str belongs"),
    "an order of shared tuples": (
        b"\x80\x03cnumpy\ndtype\n(cnumpy\ndtype\nX\x02\0\0\0f4\x85R(K\x03" + SHARED
        + b"tbtR.", "a tuple where a str belongs"),
    "a shape of shared tuples": (described(shape=shared()), r"a tuple of integers; got \(\("),
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


def test_an_array_that_is_filled_ten_thousand_times_takes_no_minute():
    pairs = b"".join(
        pickle.BINUNICODE + struct.pack("<I", len(name)) + name + value + pickle.SETITEM
        for name, value in {
            b"subclass": b"cnumpy\nndarray\n",
            b"shape": b"K\0\x85",
            b"order": pickle.NONE,
            b"dtype": b"cnumpy\ndtype\nX\2\0\0\0f4\x85R",
        }.items()
    )
    wrapper = global_(plain.WRAPPER.replace(" ", "."), b")\x81")[2:] + b"q\1" * 45_000
    fills = (b"h\2X\1\0\0\0kh\1") * 9_000 + b"h\2b" + b"sb" * 9_000
    data = b"\x80\2}" + pairs + b"q\2" + wrapper + fills + b"\x86."
    began = time.process_time()
    described, array = plain.read(data)
    assert (array.shape, described["k"].shape) == ((0,), (0,))
    assert time.process_time() - began < 5


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
