"""Verbs take every policy in the place of an agent, and say in one sentence what it lacks."""

import json
import re
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest

from astray import games
from astray.acting import initial_states
from astray.analysis.adapters import Function, from_sb3
from astray.analysis.policies import Random, Walk
from astray.analysis.trained import Network, Opaque, looked_into
from astray.envs.single import GameEnv
from astray.insight import explain as page
from astray.insight.fields import fields
from astray.lab.serving import make_lab
from astray.lab.session import Session
from astray.world import Layout
from helpers import rooms
from helpers.thorough import thorough

MAZE = games.find("maze")
ANYWHERE = MAZE.variants["anywhere-small"]
SHOWN = {"game": "maze", "variant": "anywhere-small", "level": 3}
IN_MAZE = ("--game", "maze", "--shift", "corner-small")


def always_right(images):
    return np.full(len(images), 7)


def answers(lab, kind, **more):
    first = {"id": 1, "kind": kind, "game": "maze", "variant": "anywhere-small", "level": 3}
    *_, last = Session(lab).answers(json.dumps(first | {"agent": lab.start["agent"]} | more))
    return last


@pytest.fixture(scope="module")
def ppo():
    sb3 = pytest.importorskip("stable_baselines3")
    return sb3.PPO("MlpPolicy", GameEnv("maze", "corner-small"), seed=0, device="cpu")


@pytest.mark.parametrize("policy, said", [("walk:corner", "corner"), ("random", "device")])
def test_agency_takes_any_policy(astray, policy, said):
    told = json.loads(astray("agency", "--policy", policy, *IN_MAZE, "--levels", "0:60", "--json"))
    assert told["verdict"] == said


@pytest.mark.parametrize(
    "policy, said",
    [
        ("walk:corner", "walk to corner misgeneralizes: it pursues corner, not cheese, in 100.0"),
        *thorough(("walk:cheese", "walk to cheese pursues the intended goal, cheese, in 100.0")),
        ("random", "random pursues no goal in most levels"),
    ],
)
def test_a_script_is_evaluated_as_any_policy_and_played_once(astray, policy, said):
    told = astray("evaluate", "--policy", policy, *IN_MAZE, "--levels", "0:120")
    assert told.splitlines()[-1].startswith(said)
    assert told.count("120 all") == 3


def test_a_policy_is_explained_as_far_as_it_can_be(astray, tmp_path, undrawn, monkeypatch):
    monkeypatch.setattr(page, "PIXELS", 96)
    monkeypatch.setattr(page, "FEWER", 4)
    monkeypatch.setattr(page, "PLACES", 4)
    words = ("--policy", "walk:corner", *IN_MAZE, "--level", "3", "--out", str(tmp_path / "page"))
    astray("explain", *words)
    written = re.sub('"data:[^"]*"', "", (tmp_path / "page" / "explain.html").read_text())
    assert "likeliest actions" in written and "With the cheese anywhere" in written
    assert "The posterior over what its episode" in written and "nan" not in written.lower()
    assert written.count("has no network to look into") == 2  # attribution and probes


@pytest.mark.parametrize("verb", ["explain", "lab", "agency"])
def test_what_a_policy_needs_besides_is_said(astray, verb):
    said = astray(verb, "--policy", "random", *([] if verb == "lab" else IN_MAZE[2:]), fails=True)
    assert "needs either --game or --world" in said
    if verb != "agency":
        world = ("--policy", "random", "--world", "helpers.rooms:WORLD")
        assert "sets states, which environments of a World do not" in astray(
            verb, *world, fails=True
        )


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", "--policy", "random", "--levels", "0:3"),
        ("audit", "--policy", "random", "--num-levels", "3"),
        ("compare", "random", "walk:end", "--levels", "0:3"),
    ],
)
def test_the_only_shift_of_a_world_needs_no_name(astray, words, tmp_path):
    out = tmp_path / ("table.parquet" if words[0] == "evaluate" else "pages")
    astray(*words, "--world", "helpers.rooms:WORLD", "--out", out)
    assert out.exists()
    said = astray(*words, "--game", "maze", "--out", tmp_path / "2.parquet", fails=True)
    assert "there are: corner, " in said


def test_an_agent_and_a_policy_are_not_one(astray):
    said = astray("agency", "maze-corner", "--policy", "random", *IN_MAZE, fails=True)
    assert "replaces an agent: give one of them" in said
    assert "needs --policy" in astray("explain", "maze-corner", "--game", "maze", fails=True)


def test_arrows_of_a_policy_without_a_network_are_the_actions_that_it_takes():
    walk, right = Walk("corner"), Function(always_right)
    begun = initial_states(MAZE, ANYWHERE, range(20))
    level = int(begun["level"][begun["reached_corner"] < 0][0])  # in others it begins there
    (found,) = fields(looked_into(walk, MAZE), ANYWHERE, [level])
    assert (found.policy.max(1) == 1).all() and np.isnan(found.value).all()
    corner = MAZE.cells.target(found.level.state(), "corner")
    away = found.places.distances(corner)
    assert all(
        found.towards(corner)[k] == 1 for cell, k in found.places.number.items() if away.get(cell)
    )
    (found,) = fields(looked_into(right, MAZE), ANYWHERE, [3])
    assert (found.policy[:, 7] == 1).all()
    (found,) = fields(looked_into(Random(), MAZE), ANYWHERE, [3])
    assert found.policy == pytest.approx(1 / 15)


def test_the_lab_shows_a_policy_without_values():
    lab = make_lab(Walk("cheese"), SHOWN)
    assert lab.start["agent"] == "walk to cheese"
    about = lab.agents.about("walk to cheese")
    assert about["layers"] == {} and about["shift"] == "corner-small"
    assert "elsewhere it is asked as at the beginning" in about["caveat"]
    told = answers(lab, "fields")
    assert set(told["value"]) == {None} and max(map(max, told["policy"])) == 1
    played = answers(lab, "play", actions=[], steps=60)
    assert played["ended"] and played["rewards"][-1] == 10  # it takes the cheese
    assert "has no network to look into" in answers(lab, "attribution", method="gradients")["error"]
    assert "has no network" in answers(lab, "reading", layer="policy")["error"]


def test_a_model_of_stable_baselines3_is_looked_into(ppo):
    policy = from_sb3(ppo)
    network = looked_into(policy, MAZE)
    assert isinstance(network, Network)
    lab = make_lab(policy, SHOWN)
    assert answers(lab, "fields")["value"][0] is not None
    assert "mlp_extractor.policy_net.1" in lab.agents.about("sb3")["layers"]
    seen = np.random.default_rng(0).integers(0, 255, (4, 64, 64, 3), np.uint8)
    given = ppo.policy.obs_to_tensor(seen)[0]
    theirs = ppo.policy.get_distribution(given).distribution.probs.detach().numpy()
    logits, values = network.outputs(seen)
    assert logits.softmax(-1).detach().numpy() == pytest.approx(theirs, abs=1e-5)
    known = ppo.policy.predict_values(given)[:, 0].detach().numpy()
    assert values.detach().numpy() == pytest.approx(known, abs=1e-5)


def test_a_model_behind_ones_own_wrapper_of_images_is_looked_into():
    sb3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.wrappers.TransformObservation(
        GameEnv("maze", "corner-small"),
        lambda image: image.transpose(2, 0, 1),
        gymnasium.spaces.Box(0, 255, (3, 64, 64), np.uint8),
    )
    model = sb3.PPO("MlpPolicy", env, device="cpu")
    seen = np.random.default_rng(0).integers(0, 255, (20, 64, 64, 3), np.uint8)
    theirs = model.policy.get_distribution(model.policy.obs_to_tensor(seen)[0]).distribution.logits
    lab = make_lab(from_sb3(model), SHOWN)
    logits = lab.agents.player("sb3").outputs(seen)[0].detach().numpy()
    assert logits == pytest.approx(theirs.detach().numpy(), abs=1e-6)
    assert answers(lab, "fields")["value"][0] is not None


def test_models_without_an_actor_are_played_as_functions():
    sb3 = pytest.importorskip("stable_baselines3")
    from helpers.rooms import Room

    model = sb3.DQN("MlpPolicy", Room(), buffer_size=10, device="cpu")
    assert isinstance(looked_into(from_sb3(model, greedy=True), MAZE), Opaque)
    with pytest.raises(ValueError, match=r"DQN explores at random .* without seed; give greedy=Tr"):
        from_sb3(model)


def test_what_agency_found_in_a_world_that_shows_no_images_is_kept(astray, monkeypatch, tmp_path):
    def layout(env):
        there = {"square": (env.square, 0), "end": (rooms.CELLS - 1, 0)}
        return Layout(np.ones((1, rooms.CELLS), bool), (env.x, 0), there)

    seen = replace(rooms.WORLD, cells=layout)
    makers = {name: partial(rooms.Room, name, trouble="blind") for name in seen.variants}
    blind = replace(seen, variants=makers)
    monkeypatch.setattr(rooms, "SEEN", seen, raising=False)
    monkeypatch.setattr(rooms, "BLIND", blind, raising=False)
    words = ("agency", "--policy", "walk:end", "--shift", "end", "--levels", "0:12")
    out = tmp_path / "told"
    astray(*words, "--world", "helpers.rooms:SEEN", "--out", out)
    assert len([*out.iterdir()]) == 5
    with pytest.warns(UserWarning, match="there is no video: .* its render fails"):
        assert "12 episodes" in astray(*words, "--world", "helpers.rooms:BLIND", "--out", out)
    assert {path.name for path in out.iterdir()} == {"agency.json", "episodes.parquet"}
