"""Agents of others, read from files that are made here in their formats."""

import io
import pickle
import struct
import time
import zipfile

import msgpack
import numpy as np
import pytest
import torch

from astray import files as safe_files
from astray.agents.clear import Clear
from astray.agents.impala import Impala, SamePool
from astray.agents.importers import cleanrl, files, jd, pth
from astray.agents.policy import Architecture, load, weights
from helpers.foreign import (
    Runs,
    as_cleanrl,
    as_pfrl,
    clarity,
    cleanba,
    flax_bytes,
    joblib_bytes,
    reference,
    saved,
)

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


def test_weights_in_the_byte_order_of_other_processors_are_the_same_weights():
    data, _ = clarity()
    wanted = jd.read(joblib_bytes(data)).network.state_dict()
    data["params"] = {name: array.astype(">f4") for name, array in data["params"].items()}
    found = jd.read(joblib_bytes(data)).network.state_dict()
    assert all(torch.equal(found[name], weights) for name, weights in wanted.items())


def test_a_file_of_rl_clarity_tells_what_it_was_trained_on():
    found = jd.read(joblib_bytes(clarity(gamma=0.99, num_envs=8, num_levels=None)[0]))
    assert found.world == ("coinrun", "hard")
    assert found.settings == {"gamma": 0.99, "num_envs": 8}
    assert found.told["cnn"] == "clear"


def test_a_setting_of_zero_is_told_and_no_levels_are_all_of_them():
    """Procgen then ignores the first level, too."""
    found = jd.read(joblib_bytes(clarity(entropy_coeff=0.0, num_levels=0, start_level=7)[0]))
    assert found.settings == {"gamma": 0.999, "entropy_weight": 0.0}


@pytest.mark.parametrize("said", ["", "extreme"])
def test_a_difficulty_that_is_none_of_procgens_is_not_the_usual_one(said):
    found = jd.read(joblib_bytes(clarity(distribution_mode=said)[0]))
    assert found.world == ("coinrun", said)


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
        ((16, 32, 32), as_cleanrl),
    ],
)
def test_impala_of_any_widths_computes_what_it_did_there(widths, wrap):
    state, forward = reference(widths)
    found = (cleanrl if wrap is as_cleanrl else pth).read(saved(wrap(state)))
    assert found.architecture.widths == widths
    with torch.no_grad():
        for ours, theirs in zip(found.network(IMAGES), forward(IMAGES), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


HEADS = ("fc_policy", "fc_value")


def with_gru(state, layers=1):
    """Weights of `reference` with a GRU, by train-procgen-pytorch's names, and that GRU."""
    gru = torch.nn.GRU(256, 256, layers)
    return {**state, **{f"gru.gru.{name}": x for name, x in gru.state_dict().items()}}, gru


def test_a_recurrent_agent_computes_what_it_did_there_along_an_episode():
    plain, _ = reference((2, 3, 4))
    state, gru = with_gru(plain)
    found = pth.read(saved({"model_state_dict": state}))
    assert found.architecture.name == "impala+gru"
    with torch.no_grad():
        seen = pth.read(saved(plain)).network.hidden(IMAGES)  # compared with theirs above
        recalled, last = gru(seen)
        theirs = [recalled @ state[f"{n}.weight"].T + state[f"{n}.bias"] for n in HEADS]
        begins = torch.tensor([[True], [False], [False]])
        logits, values, memory = found.network.unroll(IMAGES[:, None], torch.ones(1, 256), begins)
    torch.testing.assert_close(logits[:, 0], theirs[0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(values, theirs[1], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(memory, last, rtol=1e-4, atol=1e-5)


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


DEEP = b"\x91" * 900 + b"\xc0"  # more than Python prints
NUMBER = msgpack.ExtType(3, msgpack.packb((1, "uint8", b"a")))  # 14 MB of these took 11 s


@pytest.mark.parametrize(
    "data, why",
    [
        (b"\xc1", "damaged, or not msgpack"),
        (b"\x93\x01", "damaged, or not msgpack"),
        (b"\x91" * 5000, "damaged, or not msgpack"),
        (b"\x91\xdc\x08\x00" + b"\x90" * 2048, "2048 exceeds max_array_len"),
        (msgpack.packb([[[]] * 1000] * 2), "more than 2,000 lists"),
        (msgpack.packb([[NUMBER] * 1000] * 3), "more than 2,000 lists, dictionaries and arrays"),
        (cleanba((2, 2, 2), gamma=[0.5])[0], "its setting gamma must be a number or text; got "),
        (msgpack.packb(msgpack.ExtType(1, b"\x93\x90" + DEEP + b"\xc0")), "array of .*only num"),
        (flax_bytes({"0": {}, "1": {}}), "no settings and three modules"),
        (flax_bytes({"0": {}, "1": {"0": {}, "1": {}, "2": {}}}), "without parameters"),
        (msgpack.packb(msgpack.ExtType(7, b"")), "the extension 7"),
        (msgpack.packb(msgpack.ExtType(1, msgpack.packb(((1,), "object", b"")))), "'object'"),
        (msgpack.packb(msgpack.ExtType(1, msgpack.packb(((9,), "uint8", b"")))), "damaged"),
        (cleanba((2, 2, 2), actions=9)[0], "chooses from 9 actions"),
        (other("1", "Dense_0", "bias", weights=np.float32(1)), r"policy.bias is \(\)"),
        (other("1", "Dense_0", "bias", weights=np.full(15, 1e300)), "not all finite"),
        *((other("0", "Dense_0", "kernel", weights=np.zeros(shape, "f4")), "not all fin|it would")
          for shape in ((0, 256), (64, 0), (0, 0))),
        (other("0", "ConvSequence_0", "Conv_0", "kernel", weights=np.empty((0, 3, 3, 2**30), "f4")),
         "fits no network"),
        (b"\x82\xa10\x80\xa11\x83\xa10\x81\xa6params" + b"\x81\xa1a" * 1000
         + b"\x01\xa11\x80\xa12\x80", "without parameters"),
        (other("0", "Dense_0/kernel", weights=np.zeros((128, 256), "f4")), "without parameters"),
        (cleanba((2, 2, 2))[0].replace(b"ConvSequence_2", b"ConvSequence_3"), "does not"),
        (cleanba((2, 2, 2))[0].replace(b"ResidualBlock_1", b"ResidualBlock_0"), "lacks"),
    ],
)  # fmt: skip
def test_what_is_no_agent_of_cleanba_is_refused(data, why):
    with pytest.raises(ValueError, match=why):
        cleanrl.read(data)


def archived(data, compression=zipfile.ZIP_STORED, numbers=b""):
    """A file of torch with this pickle in it, and the numbers of a weight."""
    file = io.BytesIO()
    parts = {"data.pkl": data, "version": b"3\n", "byteorder": b"little", "data/0": numbers}
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, text in parts.items():
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
    with pytest.raises(ValueError, match="a tuple is a key of a dict"):
        pth.read(doubled(60, zipped))


TUPLES = b")q\xb4" + b"".join(  # sixty tuples, each of the last one twice
    b"h" + bytes([i]) + b"\x86q" + bytes([i + 1]) for i in range(180, 240)
)


@pytest.mark.parametrize(
    "changed, why",
    [
        (lambda old: old[: old.rindex(b"]") + 1] + TUPLES + b"a.", "or have no names"),
        (lambda old: old[: old.rindex(b"]")] + b"K\x01.", "or have no names"),
        (lambda old: old.replace(b"K\x03Nt", b"K\x03" + TUPLES + b"t"), "other than numbers"),
    ],
    ids=["keys", "no keys", "a part of other weights"],
)
def test_what_torch_looks_up_in_an_old_file_is_refused_before_it_is_hashed(changed, why):
    torch.save({"a": torch.ones(3)}, file := io.BytesIO(), _use_new_zipfile_serialization=False)
    old = file.getvalue()
    assert set(pth.weights(old)) == {"a"} and changed(old) != old
    with pytest.raises(ValueError, match=why):
        pth.read(changed(old))


def test_two_weights_of_one_layer_are_refused():
    """Else the last would be taken, and ten thousand names of one large array copied each time."""
    data, params = clarity()
    data["params"]["ppo2_model/pi/1a/conv2d/other:0"] = params["ppo2_model/pi/1a/conv2d/kernel:0"]
    with pytest.raises(ValueError, match=r"two weights of the same layer, as .*conv2d/other:0"):
        jd.read(joblib_bytes(data))


@pytest.mark.parametrize("old", [True, False])
def test_files_with_an_optimizer_are_read_in_both_formats(old):
    network = torch.nn.Linear(3, 3)
    optimizer = torch.optim.Adam(network.parameters())
    network(torch.ones(3)).sum().backward()
    optimizer.step()
    file = io.BytesIO()
    held = {"state_dict": network.state_dict(), "optimizer_state_dict": optimizer.state_dict()}
    torch.save(held, file, _use_new_zipfile_serialization=not old)
    assert set(pth.weights(file.getvalue())) == {"weight", "bias"}


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


BYTEARRAY = (
    b"\x80\x02c__builtin__\nbytearray\n\x8a\x04\x00\xe4\x0b\x04\x85R."  # of 68 million bytes
)
DEEP = b"\x80\x02})" + b"\x85" * 15_000 + b"K\x01s."
SHALLOW = (
    b"\x80\x02}X\1\0\0\0aX" + struct.pack("<I", len(DEEP) - 16) + b"a" * (len(DEEP) - 16) + b"s."
)
# A dictionary of 3,000 names, and pairs of them, each of which is copied 2,000 times.
NAMES = [b"X\x04\0\0\0%04dN" % k for k in range(3000)]
COPIED = b"\x80\x02}(" + b"".join(NAMES) + b"u"
LISTED = b"\x80\x02](" + b"".join(b"](%be" % name for name in NAMES) + b"e"
TIMES = b"q\x01ccollections\nOrderedDict\nq\x02](" + b"h\x02h\x01\x85R" * 2000 + b"e."
SHORT = (  # the first of 100 numbers
    b"\x80\2}X\1\0\0\0actorch._utils\n_rebuild_tensor_v2\n((X\7\0\0\0storagectorch\nFloatStorage\n"
    b"X\1\0\0\0000X\3\0\0\0cpuKdtQK\0K\1\x85K\1\x85\x89}tRs."
)
HUGE = torch.zeros(1).expand(2**40, 256)

REFUSED_PTH = {
    "a command": (lambda: saved({"state_dict": Runs()}), "asks for posix.system"),
    "a plain pickle": (lambda: pickle.dumps(Runs(), 2), "nothing in a file is run"),
    "nothing": (lambda: b"", "damaged, or no pickle"),
    "half a file": (lambda: changed()[:5000], "damaged, or not a file of torch"),
    "a list": (lambda: saved([1, 2]), "holds a list, not weights by name"),
    "no weights": (lambda: saved({"steps": 5}), "holds 'steps', which is not a weight"),
    "another network": (lambda: saved({"conv.weight": torch.zeros(3)}), "not an IMPALA network"),
    "half a GRU": (lambda: changed(gru__gru__bias_ih_l0=torch.zeros(768)), "lacks cell.weight_ih"),
    "a GRU of two layers": (
        lambda: saved(with_gru(reference((2, 2, 2))[0], layers=2)[0]),
        "has body.gru.gru.weight_ih_l1",
    ),
    "9 actions": (lambda: changed(fc_policy__weight=torch.zeros(9, 256)), "9 actions, of CoinRun"),
    "16 actions": (lambda: changed(fc_policy__weight=torch.zeros(16, 256)), "from 16 actions; Pro"),
    "a layer less": (lambda: changed(fc_value__bias=None), "lacks value.bias"),
    "a layer more": (lambda: changed(more=torch.zeros(3)), "has more, which its network does not"),
    "another size": (lambda: changed(embedder__fc__weight=torch.zeros(256, 9)), "it would be"),
    "no number": (lambda: changed(fc_value__bias=torch.full((1,), torch.nan)), "not all finite"),
    "a whole number": (lambda: changed(fc_value__bias=torch.ones(1, dtype=int)), "not all finite"),
    "more than the file": (lambda: changed(embedder__fc__weight=HUGE), "more than the file holds"),
    "no dimension": (lambda: changed(fc_policy__weight=torch.tensor(1.0)), r"y.weight is \(\)"),
    "no number in 32 bits": (
        lambda: changed(fc_value__bias=torch.full((1,), 1e300, dtype=torch.float64)),
        "not all finite"),
    "a width without numbers": (
        lambda: changed(embedder__block1__conv__weight=torch.empty(2**31 - 1, 0, 3, 3)),
        "fits no network",
    ),
    "a layer twice": (lambda: saved({**reference((2, 2, 2))[0], "policy.bias": torch.ones(15)}),
                      "two weights of the same layer"),
    "sparse weights": (lambda: changed(fc_value__bias=torch.zeros(1).to_sparse()), "asks for t"),
    "no memory": (lambda: changed(fc_value__bias=torch.zeros(1, device="meta")), "asks for torch"),
    "eight bits": (
        lambda: changed(fc_value__bias=torch.zeros(1).to(torch.float8_e4m3fn)), "asks for torch"),
    "a wide bytearray": (lambda: archived(BYTEARRAY), "asks for __builtin__.bytearray"),
    "a wide bytearray, as of old": (lambda: BYTEARRAY, "asks for __builtin__.bytearray"),
    "deep tuples as a key": (lambda: archived(DEEP), "a tuple is a key"),
    "deep tuples as a key, as of old": (lambda: DEEP, "a tuple is a key"),
    "copies of a dictionary": (lambda: archived(COPIED + TIMES), "a dict where a list belongs"),
    "copies of a list": (lambda: archived(LISTED + TIMES), "more than 100,000 parts"),
    "copies, as of old": (lambda: LISTED + TIMES, "more than 100,000 parts"),
    "a part in capitals": (
        lambda: archived(DEEP).replace(b"data.pkl", b"DATA.PKL"), "0 parts are a pickle"),
    "two tables of contents": (
        lambda: archived(DEEP).rpartition(b"PK\5\6")[0] + archived(SHALLOW), "holds 'a', which"),
    "an archive behind a pickle": (lambda: DEEP + archived(SHALLOW), "a tuple is a key"),
    "a part that is too short": (lambda: archived(SHORT, numbers=bytes(8)), "more than the file"),
    "a compressed pickle": (lambda: archived(BYTEARRAY, zipfile.ZIP_BZIP2), "is compressed by"),
    "compressed weights": (lambda: archived(b"\x80\x02}.", zipfile.ZIP_DEFLATED), "compressed"),
    "a wrong checksum": (
        lambda: archived(BYTEARRAY).replace(BYTEARRAY, BYTEARRAY[:-1] + b" "), "damaged, or not"),
}  # fmt: skip


def test_names_of_weights_that_torch_takes_for_one_are_refused():
    """Before 2.13 it read a thousand numbers where there is one."""
    asked = b"(X\7\0\0\0storagectorch\nFloatStorage\nX\1\0\0\0%sX\3\0\0\0cpuM\xe8\3tQ"
    data = b"\x80\2]" + asked % b"a" + b"a" + asked % b"A" + b"a."
    with zipfile.ZipFile(file := io.BytesIO(archived(data)), "a") as archive:
        for key in "aA":
            archive.writestr(f"archive/data/{key}", bytes(4000))
    with pytest.raises(ValueError, match="or have one name"):
        pth.read(file.getvalue())


def test_names_of_ten_thousand_weights_are_compared_once():
    """All were for each of them, which took 20 seconds."""
    begin = b"\x80\2](X\7\0\0\0storageq\0ctorch\nFloatStorage\nq\1X\3\0\0\0cpuq\2"
    keys = [b"%05d" % key for key in range(10_000)]
    asked = (b"(h\0h\1X\5\0\0\0" + key + b"h\2K\1tQ" for key in keys)
    with zipfile.ZipFile(
        file := io.BytesIO(archived(begin + b"".join(asked) + b"e.")), "a"
    ) as parts:
        for key in keys:
            parts.writestr(f"archive/data/{key.decode()}", bytes(4))
    began = time.process_time()
    with pytest.raises(ValueError, match="it holds a list, not weights by name"):
        pth.read(file.getvalue())
    assert time.process_time() - began < 5


def old_file(state, keys):
    """A file of torch before 1.6 that has the numbers of these weights alone."""
    torch.save(state, file := io.BytesIO(), _use_new_zipfile_serialization=False)
    begin, _, numbers = file.getvalue().rpartition(b"\x80\x02]")
    assert numbers
    return begin + pickle.dumps(keys, 2) + numbers[numbers.index(b".") + 1 :]


def test_weights_without_numbers_are_refused():
    """Torch leaves them as what was in its memory before."""
    state = reference((2, 2, 2))[0]
    with pytest.raises(ValueError, match="its weights are more than the file holds"):
        pth.read(old_file(state, []))


def test_an_archive_with_two_parts_of_one_name_is_refused():
    with zipfile.ZipFile(file := io.BytesIO(changed()), "a") as archive:
        name = next(one for one in archive.namelist() if one.endswith("/data/0"))
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr(name, bytes(len(archive.read(name))))
    with pytest.raises(ValueError, match="its parts overlap"):
        pth.read(file.getvalue())


def test_an_object_that_is_made_without_a_call_is_no_dictionary():
    hidden = b"}X\3\0\0\0getK\1sb."
    with pytest.raises(ValueError, match="it makes an object of 'collections OrderedDict'"):
        pth.read(archived(b"\x80\2ccollections\nOrderedDict\n)\x81" + hidden))


@pytest.mark.parametrize("name", ["get", "keys"])
def test_a_dictionary_whose_methods_a_file_hides_is_refused(name):
    hidden = b"}X%s\0\0\0%sK\1sb." % (bytes([len(name)]), name.encode())
    with pytest.raises(ValueError, match="more than torch notes of a state's modules"):
        pth.read(archived(b"\x80\2ccollections\nOrderedDict\n)R" + hidden))


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
    "no array": (
        lambda: joblib_bytes({"args": {}, "params": {"a": 3}}),
        "'a', which is not an array",
    ),
    "no word": (lambda: joblib_bytes(clarity(cnn=np.zeros(3))[0]), "its network is array"),
    "no dimension": (lambda: wrong("pi/b", ()), r"policy.bias is \(\)"),
    "no inputs": (lambda: wrong("pi/dense/kernel", (0, 256)), r"is \(256, 0\); it would be"),
    "no outputs": (lambda: wrong("pi/dense/kernel", (512, 0)), r"is \(0, 512\); it would be"),
    "nothing": (lambda: wrong("pi/dense/kernel", (0, 0)), r"is \(0, 0\); it would be"),
    "levels in a list": (
        lambda: joblib_bytes(clarity(num_levels=[500])[0]),
        r"its setting num_levels must be a number or text; got \[500\]",
    ),
    "a difficulty in a list": (
        lambda: joblib_bytes(clarity(distribution_mode=["easy"])[0]),
        r"its setting distribution_mode must be a number or text; got \['easy'\]",
    ),
    "a difficulty of 0": (
        lambda: joblib_bytes(clarity(distribution_mode=0)[0]),
        "its setting distribution_mode must be text; got 0",
    ),
    "a number as a game": (
        lambda: joblib_bytes(clarity(env_name=7.5)[0]),
        "its setting env_name must be text; got 7.5",
    ),
    "no channels": (lambda: wrong("pi/2a/conv2d/kernel", (3, 3, 0, 64)), r"is \(64, 0, 3, 3\); it"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED_JD)
def test_a_jd_that_is_refused_says_why(name):
    make, said = REFUSED_JD[name]
    with pytest.raises(ValueError, match=said):
        jd.read(make())


def test_a_file_with_a_long_name_is_refused_in_a_few_words(tmp_path):
    (tmp_path / "agent.pth").write_bytes(saved({"x" * 100_000: torch.zeros(3)}))
    with pytest.raises(ValueError, match="its weights are x") as found:
        files.read(tmp_path / "agent.pth")
    assert len(str(found.value)) < 1000


def test_an_archive_of_many_parts_is_not_opened(monkeypatch):
    monkeypatch.setattr(safe_files, "MEMBERS", 2)
    with pytest.raises(ValueError, match="it has 4 files; at most 2 are read"):
        pth.read(archived(b"\x80\x02}."))


def test_a_setting_of_many_dimensions_is_not_written_out():
    said = r"its network is an array of shape \(2, 2, 2"
    with pytest.raises(ValueError, match=said):
        jd.read(joblib_bytes(clarity(cnn=np.zeros((2,) * 22, np.uint8))[0]))


def test_a_file_of_another_kind_or_size_is_refused(tmp_path, monkeypatch):
    with pytest.raises(
        ValueError, match=r"an agent's file is \.pth, \.pt, \.jd, \.cleanrl_model; got \.zip"
    ):
        files.read(tmp_path / "agent.zip")
    (tmp_path / "agent.jd").write_bytes(bytes(20))
    monkeypatch.setattr(files, "LARGEST", 10)
    with pytest.raises(ValueError, match="must be of at most 10 bytes; it has 20"):
        files.read(tmp_path / "agent.jd")
