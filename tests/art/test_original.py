"""With the original's pictures, images are the original's in every pixel."""

import hashlib
import io
import json
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from astray import games
from astray.agents.policy import Architecture, weights
from astray.analysis.policies import Agent
from astray.analysis.runs import open_run
from astray.art import original
from astray.cli import main
from astray.envs.vector import GameVectorEnv, picture
from astray.games.maze.variants import Maze
from astray.kernel import qt
from astray.kernel.cells import OPEN, TILE, cell_box, paint_cells
from astray.training.config import Config
from helpers import processes
from helpers.cases import REFERENCE
from helpers.drawn import DRAWN, digest, environment
from helpers.recorded import RECORDED

FRAMES = json.loads((REFERENCE / "frames.json").read_text())


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_the_originals(name):
    for episode in FRAMES[name]:
        env = environment(DRAWN[name])
        images, _ = env.reset(seed=0, options={"level": episode["level"]})
        found = {"0": digest(images[0])}
        for t, action in enumerate(episode["actions"], 1):
            images, *_ = env.step(np.array([int(action)]))
            found[str(t)] = digest(images[0])
        differ = [t for t, frame in episode["frames"].items() if found[t] != frame]
        assert not differ, f"level {episode['level']}, steps {differ}"


def test_every_configuration_was_recorded():
    assert set(FRAMES) >= {name for name in RECORDED if "region" not in name} - {
        "coinrun_random50", "keys_many_chests_penalties",
    }  # fmt: skip
    assert all(sum(len(e["frames"]) for e in episodes) >= 72 for episodes in FRAMES.values())


INTERPRETED = """
import sys, numpy as np
from helpers.drawn import DRAWN, digest, environment
for name in ("coinrun", "maze_memory", "keys_many_keys"):
    env = environment(DRAWN[name])
    images, _ = env.reset(seed=0, options={"level": 7})
    print(digest(images[0]))
    for action in (8, 8, 1, 1):
        images, *_ = env.step(np.array([action]))
    print(digest(images[0]))
"""


def test_interpreted_code_draws_the_same():
    environment(DRAWN["coinrun"])
    said = [
        subprocess.run(
            [sys.executable, "-c", INTERPRETED],
            env=processes.environment(NUMBA_DISABLE_JIT=disabled), capture_output=True, check=True,
        ).stdout
        for disabled in ("0", "1")
    ]  # fmt: skip
    assert said[0] == said[1] and len(said[0].split()) == 6


@pytest.mark.parametrize("pixels", [64, 63, 130, 512])
def test_pictures_for_people_have_the_same_things_at_any_scale(pixels):
    for name in ("coinrun", "maze_memory", "keys_many_keys"):
        env = environment(DRAWN[name], 2)
        images, _ = env.reset(seed=0, options={"level": [3, 4]})
        shown = env.picture(pixels)
        assert shown.shape == (2, pixels, pixels, 3)
        assert pixels != 64 or np.array_equal(shown, images)
        small = [np.array(Image.fromarray(one).resize((8, 8), Image.Resampling.BOX), int)
                 for one in (*shown, *images)]  # fmt: skip
        # Nearest pixels of fine pictures are speckled at 64 pixels; their means are alike.
        assert np.abs(small[0] - small[2]).mean() < 16 and np.abs(small[1] - small[3]).mean() < 16


def test_versions_of_qt_differ_in_a_few_pixels():
    """Since 5.13 backgrounds are found by another formula."""
    shown = []
    for art in ("original", "original-5.12"):
        environment(DRAWN["coinrun"])
        env = GameVectorEnv("coinrun", "coin-end", 64, art=art)
        shown.append(env.reset(seed=0, options={"level": np.arange(64)})[0])
    different = (shown[0] != shown[1]).any(-1)
    assert 0 < different.any((1, 2)).mean() < 0.5 and different.mean() < 0.01


def test_a_goal_that_was_reached_is_gone_and_what_is_next_is_painted():
    for name in ("maze", "maze_memory"):
        env = environment(DRAWN[name])
        env.reset(seed=0, options={"level": 5})
        states = env.get_state()
        x, y = int(states["goal_x"][0]), int(states["goal_y"][0])
        states["x"], states["y"] = x + 0.5, y + 0.5
        on_goal = env.set_state(states)
        states["reached_goal"], states["cell"][0, y, x] = states["time"], 0
        assert not np.array_equal(env.set_state(states), on_goal)


# Copies of pictures, beside a slow version that draws one cell after the other.


def naive_span(begin, length, side, size, rule):
    """Target pixels and the source pixel of each."""
    first, after = (int(np.floor(edge + 0.5)) for edge in (begin, begin + length))
    first, after = max(first, 0), min(after, side)
    scale = size / length
    step = int(65536 * scale)
    product = (first + 0.5 - begin) * (step if rule == qt.SPRITE else scale)
    base = int(np.ceil(product if rule == qt.SPRITE else product * 65536)) - 1
    pairs = [(k, (base + (k - first) * step) >> 16) for k in range(first, after)]
    return pairs[:-1] if pairs and pairs[-1][1] >= size else pairs


def naive_draw(image, source, rect, rule=qt.SPRITE):
    """Draw a premultiplied picture [H, W, 4] as exact arithmetic has it."""
    left, top, wide, high = rect
    for row, v in naive_span(top, high, len(image), len(source), rule):
        for column, u in naive_span(left, wide, len(image), len(source[0]), rule):
            over, under = source[v, u].astype(int), image[row, column].astype(int)
            product = under * (255 - over[3])
            image[row, column] = over[:3] + ((product + (product >> 8) + 128) >> 8)


def made_pictures(random, kinds):
    """Pictures of random pixels, as RGBA and as the arrays that compiled code takes."""
    pictures, flat, places = [], [np.zeros(5, np.uint32)], []
    for height, width, opaque in kinds:
        rgba = random.integers(0, 256, (height, width, 4)).astype(np.uint8)
        alpha = (
            np.full((height, width), 255)
            if opaque
            else random.choice([0, 90, 255], (height, width))
        )
        packed = original._packed(np.dstack([rgba[..., :3], alpha]).astype(np.uint32), False)
        pictures.append(packed[..., None] >> np.array([0, 8, 16, 24], np.uint32) & 255)
        places.append((sum(map(len, flat)), height, width))
        flat.append(packed.reshape(-1).astype(np.uint32))
    return pictures, np.concatenate(flat), np.array(places)


@pytest.mark.parametrize("seed", range(12))
def test_cells_painted_at_once_are_those_drawn_one_by_one(seed):
    random, side = np.random.default_rng(seed), int(np.random.default_rng(seed).choice([64, 50]))
    tile = (TILE, TILE, True)
    pictures, pixels, places = made_pictures(
        random, [(70, 90, True), tile, tile, (27, 31, False), (128, 128, False)]
    )
    world, visible = 20, int(random.choice([13, 8, 20]))
    x, y = (np.float32(v) for v in random.uniform(1, 19, 2))
    if visible == world:
        x = y = np.float32(world / 2)
    seen = qt.camera(side, visible, x, y)
    half = np.float32(visible) / np.float32(2) + np.float32(1)
    left, low = (int(v - half) if visible < world else 0 for v in (x, y))
    count = world if visible == world else int(x + half) - left + 1
    rows = world if visible == world else int(y + half) - low + 1
    choices = [OPEN] * 6 + [1, 1, 1, 2, 2, -2 - 3, -2 - 4]
    cells = np.full((rows, count), 1)
    for j in range(rows):
        for i in range(count):
            if 0 <= low + j < world and 0 <= left + i < world:
                cells[j, i] = random.choice(choices)
    offset = float(np.float32(random.random()))
    image, expected = np.zeros((side, side, 3), np.uint8), np.zeros((side, side, 3), np.uint8)
    paint_cells(image, pixels, places, cells, seen, left, low, world, (0, offset), qt.GENERIC)

    size = np.float32(world)
    begin, top, wide, high = qt.rectangle(seen, np.float32(0), size, size, size, np.float32(0))
    aspect = np.float32(90 / 70)
    shift = wide * float(np.float32(offset) * (aspect - np.float32(1)))
    naive_draw(expected, pictures[0], (begin - shift, top, wide * float(aspect), high), qt.GENERIC)
    for i in range(count):
        for j in range(rows):
            if cells[j, i] != OPEN:
                which = cells[j, i] if cells[j, i] > 0 else -2 - cells[j, i]
                naive_draw(expected, pictures[which], cell_box(seen, left + i, low + j))
    assert np.array_equal(image, expected)


@pytest.mark.parametrize("eighths, turns", [(-4, 2), (-2, 1), (0, 0), (2, 3)])
def test_quarter_turns_turn_pixels(eighths, turns):
    """A picture on as many pixels as it has; numpy turns against the clock."""
    random = np.random.default_rng(0)
    (source,), pixels, places = made_pictures(random, [(20, 20, True)])
    image = np.zeros((64, 64, 3), np.uint8)
    qt.blit_turned(image, pixels, places[0], (10.0, 30.0, 20.0, 20.0), eighths)
    assert np.array_equal(image[30:50, 10:30], np.rot90(source, turns)[..., :3])
    image[30:50, 10:30] = 0
    assert not image.any()


@pytest.mark.parametrize("eighths", [-3, -1, 1, 3])
def test_oblique_turns_cover_the_turned_square(eighths):
    (_,), pixels, places = made_pictures(np.random.default_rng(1), [(9, 9, True)])
    pixels[places[0, 0] :] = 0xFFFFFFFF
    image = np.zeros((64, 64, 3), np.uint8)
    qt.blit_turned(image, pixels, places[0], (22.0, 22.0, 20.0, 20.0), eighths)
    y, x = np.mgrid[:64, :64] + 0.5 - 32
    diamond = abs(x) + abs(y)
    assert (image[diamond < 13.2] == 255).all() and (image[diamond > 15] == 0).all()


# Importing.


@pytest.fixture
def pack(tmp_path, monkeypatch):
    """A pack of three small pictures in place of the original's; where it would be kept."""
    files = {}
    for k, path in enumerate(("kenney/a.png", "misc_assets/b.png", original.FORK_ALONE[0])):
        rgba = np.random.default_rng(k).integers(0, 256, (4 + k, 5, 4)).astype(np.uint8)
        Image.fromarray(rgba).save(tmp_path / "one.png")
        files[path] = (tmp_path / "one.png").read_bytes()
    pictures = {
        path: original.Picture(path, len(data), hashlib.sha256(data).hexdigest())
        for path, data in files.items()
    }
    monkeypatch.setattr(original, "PICTURES", pictures)
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path / "art"))
    return files


def wheel_of(path, files, prefix=original.INSIDE):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(prefix + name, data)
    return path


def test_a_wheel_and_a_checkout_are_imported(pack, tmp_path):
    lines = {original.FORK_ALONE[0]}
    wheel = wheel_of(tmp_path / "a.whl", {p: d for p, d in pack.items() if p not in lines})
    assert original.take(wheel) == [*lines] == original.missing()
    for path, data in pack.items():
        file = tmp_path / "fork" / original.INSIDE / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    assert original.take(tmp_path / "fork") == []
    assert original.take(wheel) == []  # and what only the fork has stays
    assert original.take(tmp_path / "fork" / original.INSIDE) == []


def bomb(pack, path):
    """A picture that unpacks to a hundred times as much as it may."""
    return wheel_of(path, pack | {"kenney/a.png": b"\0" * 20_000_000})


def cut(pack, path):
    data = wheel_of(path, pack).read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def spoilt(pack, path):
    """The first picture's compressed bytes are changed."""
    data = bytearray(wheel_of(path, pack).read_bytes())
    data[100:140] = bytes(40)
    path.write_bytes(data)
    return path


def plain(text, path):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "make, said",
    [
        (bomb, "its kenney/a.png is another picture"),
        (cut, "is no wheel, or not all of one"),
        (spoilt, "is no wheel, or not all of one|is another picture"),
        (lambda pack, path: plain("", path), "is no wheel, or not all of one"),
        (lambda pack, path: plain("wheel", path), "is no wheel, or not all of one"),
        (lambda pack, path: wheel_of(path, {}), "it lacks kenney/a.png"),
        (lambda pack, path: wheel_of(path, pack, "procgen/"), "it lacks kenney/a.png"),
        (lambda pack, path: wheel_of(path, pack | {"misc_assets/b.png": b"1"}), "b.png is another"),
        (lambda pack, path: wheel_of(path, pack | {"../../x.png": b"1"}), "is refused: it holds"),
        (lambda pack, path: wheel_of(path, {"/etc/x": b"1"}, ""), "is refused: it holds '/etc/x'"),
        (lambda pack, path: path.parent, "is no checkout of Procgen"),
    ],
)  # fmt: skip
def test_what_is_not_the_original_is_refused_and_nothing_written(pack, tmp_path, make, said):
    (tmp_path / "in").mkdir()
    with pytest.raises(ValueError, match=said):
        original.take(make(pack, tmp_path / "in" / "a.whl"))
    assert not (tmp_path / "art").exists() and len(original.missing()) == 3


def test_a_wheel_that_is_not_there_and_pip_that_cannot_say_so(pack, tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="no wheel and no checkout of Procgen at"):
        original.take(tmp_path / "a.whl")
    monkeypatch.setattr(original, "DOWNLOAD", ("download", "--no-index", "procgen==0.10.7"))
    with pytest.raises(
        OSError, match=f"pip could not download Procgen .*; download {original.WHEEL}"
    ):
        original.take()


def test_pictures_are_premultiplied_and_backgrounds_opaque(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    names = list(pack)
    pixels, places = original.atlas(names, backgrounds=1)
    for k, name in enumerate(names):
        begin, height, width = places[k]
        (tmp_path / "one.png").write_bytes(pack[name])
        rgba = np.array(Image.open(tmp_path / "one.png")).astype(int)
        ours = pixels[begin : begin + height * width].reshape(height, width).astype(np.int64)
        ours = ours[..., None] >> np.array([0, 8, 16, 24]) & 255
        alpha = np.full_like(rgba[..., 3:], 255) if k == 0 else rgba[..., 3:]
        assert np.array_equal(ours[..., 3:], alpha)
        assert np.abs(ours[..., :3] - rgba[..., :3] * alpha / 255).max() <= 0.5 + 1e-9


def test_what_was_decoded_is_kept_and_made_anew_where_it_is_broken(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    pixels, _ = original.atlas(list(pack))
    (kept,) = (tmp_path / "art").glob("decoded-*.npy")
    for broken in (b"", kept.read_bytes()[:150], b"x" * 500):
        whole = pixels.copy()
        del pixels
        kept.unlink()
        kept.write_bytes(broken)
        pixels, _ = original.atlas(list(pack))
        assert np.array_equal(pixels, whole)
    kept.unlink()
    (tmp_path / "art/kenney/a.png").write_bytes(b"other")
    with pytest.raises(ValueError, match="is not what was imported; remove it, and: astray art"):
        original.atlas(list(pack))


def test_a_decoded_picture_that_was_changed_is_not_shown(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    pixels, _ = original.atlas(list(pack))
    whole = pixels.copy()
    del pixels
    (kept,) = (tmp_path / "art").glob("decoded-*.npy")
    changed = bytearray(kept.read_bytes())
    changed[-original.SUM - 4] ^= 1  # of the last pixel; the size stays
    kept.write_bytes(changed)
    assert np.array_equal(original.atlas(list(pack))[0], whole)


def test_sizes_of_decoded_pictures_are_seen_whoever_signed_them(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    pixels, _ = original.atlas(list(pack))
    whole = pixels.copy()
    del pixels
    (kept,) = (tmp_path / "art").glob("decoded-*.npy")
    sizes = np.zeros(2 * len(pack), np.uint32)
    data = io.BytesIO()
    np.save(data, sizes)
    kept.write_bytes(data.getvalue() + hashlib.sha256(data.getvalue()).digest())
    assert np.array_equal(original.atlas(list(pack))[0], whole)


def test_without_the_pictures_one_sentence_says_how_to_get_them(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path / "none"))
    with pytest.raises(FileNotFoundError, match="to get them: astray art import"):
        original.atlas(list(original.PICTURES)[:3])
    monkeypatch.setattr(sys, "argv", ["astray", "art"])
    main()
    said = capsys.readouterr().out
    assert "0 of 135" in said and "astray art import" in said and not (tmp_path / "none").exists()


def test_symbols_need_no_pictures(tmp_path, monkeypatch):
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path))
    env = GameVectorEnv("coinrun", "coin-end", 2, observation="symbolic", art="original")
    env.reset(seed=0)


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"goal_shape": "ring", "goal_colour": "blue"}, "the original has no blue ring; it"),
        ({"walls": "hedge"}, "the original has walls of sand alone; these are of hedge"),
    ],
)  # fmt: skip
def test_what_the_original_never_drew_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        games.find("maze").drawn("original").art(replace(Maze(about=""), **changes), 64)


def test_unknown_art_is_refused():
    with pytest.raises(ValueError, match="unknown art 'stock' of maze; there are: own, original"):
        GameVectorEnv("maze", "corner", art="stock")


def test_an_agent_is_shown_what_it_was_trained_on(tmp_path):
    architecture = Architecture("impala", (64, 64, 3), (), 15)
    (tmp_path / "agent.safetensors").write_bytes(
        weights(architecture.build(), architecture, "maze")
    )
    agent = Agent(tmp_path / "agent.safetensors", "maze", art="original")
    env = GameVectorEnv("maze", "anywhere-small", 2)
    images, _ = env.reset(seed=0)
    with pytest.raises(
        ValueError, match="is to see art 'original'; these images are drawn with 'own'"
    ):
        agent.actions(env, images)
    agent.art = "own"
    assert agent.actions(env, images).shape == (2,)


def test_runs_say_what_they_were_trained_on_and_another_is_shown_where_asked_for(tmp_path):
    from astray.training import checkpoint

    config = Config(
        observation="symbolic", network="mlp", art="original", num_envs=8, minibatches=1
    )
    folder = tmp_path / "checkpoints" / "8"
    folder.mkdir(parents=True)
    written = {"config": config.to_json()}
    (tmp_path / "config.json").write_text(json.dumps(written))
    architecture = Architecture("mlp", (4, 25, 25), (1, 1, 6, 6), 15)
    network = architecture.build()
    (folder / checkpoint.AGENT).write_bytes(weights(network, architecture, "maze"))
    assert open_run(tmp_path)[0].art == "original"
    assert open_run(tmp_path, art="own")[0].art == "own"
    with pytest.raises(ValueError, match="unknown art 'stock' of maze"):
        open_run(tmp_path, art="stock")
    del written["config"]["art"]  # of a run older than the setting
    (tmp_path / "config.json").write_text(json.dumps(written))
    assert open_run(tmp_path)[0].art == "own"


def test_states_are_pictured_with_the_art_that_is_asked_for():
    env = environment(DRAWN["maze"])
    images, _ = env.reset(seed=0)
    assert np.array_equal(picture("maze", env.variant, env.states, 64, "original"), images)
    assert not np.array_equal(picture("maze", env.variant, env.states, 64), images)
