"""A World is trained on by the loop that trains on games."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium import spaces

from astray.analysis.adapters import from_trainer
from astray.analysis.critic import visit
from astray.analysis.evaluate import evaluate
from astray.analysis.runs import evaluate_runs, load_agent
from astray.analysis.trained import Network
from astray.envs.restarting import Restarting, action_table, as_seen
from astray.experiments import outcomes, spec
from astray.experiments.keep import keep
from astray.experiments.run import reproduce
from astray.experiments.spec import Experiment, Plan
from astray.experiments.sweep import run as sweeping
from astray.insight.activations import capture
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.folders import AGENT, latest
from astray.training.loop import iterate, train
from astray.world import find
from helpers.rooms import CELLS, WORLD, Room

LEVELS = range(100, 200)
SMALL = Config(
    WORLD, "end", validation="anywhere", validation_every=1, num_envs=8, num_steps=32,
    minibatches=4, steps=4 * 256,
)  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "room"
    train(replace(SMALL, steps=14 * 256), folder, progress=False)
    return folder


def test_an_agent_learns_the_proxy_of_a_world(run):
    last = checkpoint.metrics(run)[-1]
    assert last["training/return"] > 0.95 > last["validation/return"]
    result = evaluate_runs([run], np.arange(200_000, 200_100))
    assert "misgeneralizes: it pursues end, not square" in result.verdict


@pytest.mark.parametrize("knobs", [{"trouble": "parts"}, {"vector": True}])
def test_a_trainers_policy_plays_as_its_checkpoint_does(knobs, tmp_path):
    variant = WORLD.variant("anywhere").with_knobs(knobs)
    for iteration in iterate(replace(SMALL, steps=512, knobs=knobs), tmp_path):
        live = evaluate(from_trainer(iteration.trainer), WORLD, variant, range(20))
    assert live.equals(evaluate(load_agent(tmp_path), WORLD, variant, range(20)))


def test_a_trained_agent_plays_as_in_a_loop_by_hand(run):
    agent = load_agent(run, "greedy")
    table = evaluate_runs([run], np.arange(200_000, 200_005), mode="greedy").episodes
    for level, length in table.filter(seed=0).select("level", "length").rows():
        env, ends = Room("anywhere"), [False]
        seen, _ = env.reset(seed=level)
        while not any(ends):
            logits, _ = agent.outputs(seen.reshape(1, -1))
            seen, _, *ends, _ = env.step(int(logits.argmax()))
        assert env.time == length


@pytest.mark.parametrize("knobs", [{}, {"vector": True}])
def test_a_training_that_stops_within_episodes_resumes_to_the_bit(knobs, tmp_path):
    config = replace(SMALL, knobs=knobs)
    train(config, tmp_path / "whole", progress=False)
    next(iterate(config, tmp_path / "stopped"))
    train(config, tmp_path / "stopped", progress=False)
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert checkpoint.metrics(whole) == checkpoint.metrics(stopped)
    weights = [(latest(folder) / AGENT).read_bytes() for folder in (whole, stopped)]
    assert weights[0] == weights[1]


def test_environments_restart_as_in_a_loop_by_hand():
    env, out = Restarting(WORLD, WORLD.variant("anywhere"), 3, LEVELS, "symbolic"), None
    seen, _ = env.reset(seed=7)
    mine = [Room("anywhere") for _ in range(3)]
    hand = [one.reset(seed=int(k))[0] for one, k in zip(mine, env.states["level"], strict=True)]
    random, out, begun = np.random.default_rng(0), np.empty_like(seen), 0
    for _ in range(40):
        assert (seen == [x.ravel() for x in hand]).all()
        actions = random.integers(2, size=3)
        seen, rewards, terminated, truncated, info = env.step(actions, out)
        for i, one in enumerate(mine):
            hand[i], *results, _ = one.step(actions[i])
            assert results == [rewards[i], terminated[i], truncated[i]]
            if terminated[i] or truncated[i]:
                assert (info["final_obs"][i] == hand[i].ravel()).all()
                assert info["final_info"]["time"][i] == one.time
                assert (info["final_info"]["reached_square"][i] >= 0) == terminated[i]
                level = int(env.states["level"][i])
                hand[i], begun = one.reset(seed=level)[0], begun + (level in LEVELS)
    assert begun > 5


def test_another_seed_draws_other_levels():
    drawn = []
    for seed in (0, 0, 1):
        env = Restarting(WORLD, WORLD.variant("anywhere"), 4, LEVELS, "symbolic")
        env.reset(seed=seed * 100)
        drawn.append(env.states["level"].tolist())
    assert drawn[0] == drawn[1] != drawn[2]


def test_actions_of_several_parts_are_one_choice_among_all():
    table = action_table(spaces.MultiDiscrete([2, 3], start=[0, 5]))
    assert table.tolist() == [[0, 5], [0, 6], [0, 7], [1, 5], [1, 6], [1, 7]]
    assert action_table(spaces.Discrete(3, start=-1)).tolist() == [-1, 0, 1]


def test_whole_numbers_are_scaled_by_their_bounds_and_parts_are_joined():
    for kind in (np.uint8, np.int8, np.int32, np.int64):
        seen = as_seen(spaces.Box(2, 6, (2,), kind), "symbolic", np.array([[2, 5]], kind))
        assert seen.tolist() == [[0, 0.75]] and seen.dtype == np.float32
    both = spaces.Dict({"cell": spaces.Discrete(3), "way": spaces.Box(-1, 1, (1,), np.float32)})
    shown = {"cell": np.array([2, 0]), "way": np.array([[0.5], [-1]], np.float32)}
    assert as_seen(both, "symbolic", shown).tolist() == [[0, 0, 1, 0.5], [1, 0, 0, -1]]
    image = spaces.Tuple([spaces.Box(0, 255, (1,), np.uint8), both])
    seen = as_seen(image, "symbolic", (np.array([[51], [255]], np.uint8), shown))
    assert np.allclose(seen, [[0.2, 0, 0, 1, 0.5], [1, 1, 0, 0, -1]])


@pytest.mark.parametrize("kind", [np.int32, np.int64])
@pytest.mark.parametrize("low, high", [(-np.inf, np.inf), (0, np.inf), (-np.inf, 9)])
def test_whole_numbers_without_bounds_differ_in_a_vector(low, high, kind):
    space = spaces.Box(low, high, (2,), kind)
    assert as_seen(space, "symbolic", np.array([[0, 5]], kind)).tolist() == [[0, 5]]
    far = spaces.Box(10**9, 10**9 + 8, (2,), kind)
    assert as_seen(far, "symbolic", far.low[None] + [[2, 4]]).tolist() == [[0.25, 0.5]]


def counted(high, **knobs):
    env = Room(**knobs)
    env._seen = lambda: np.array([env.x, env.square])
    env.observation_space = spaces.Box(0, high, (2,), int)
    return env


def test_bounds_of_another_variant_change_nothing_that_an_agent_sees_there(tmp_path):
    told = []
    for high in (8, 80):
        variants = {
            "end": partial(counted, 8),
            "anywhere": partial(counted, high, place="anywhere"),
        }
        world = replace(WORLD, name="counted", variants=variants)
        *_, last = iterate(replace(SMALL, game=world, steps=512), run := tmp_path / f"{high}")
        live = evaluate(from_trainer(last.trainer), world, "anywhere", range(20))
        kept = evaluate(load_agent(run), world, "anywhere", range(20))
        told.append([checkpoint.metrics(run), live.rows(), kept.rows()])
    assert told[0] == told[1]


@pytest.mark.parametrize("huge", [np.inf, -1e300])
def test_numbers_that_a_network_cannot_see_are_told(huge):
    space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
    assert as_seen(space, "symbolic", np.array([[1e30, 2]])).tolist() == [[np.float32(1e30), 2]]
    with pytest.raises(ValueError, match="a network sees finite numbers of 32 bits; got others of"):
        as_seen(space, "symbolic", np.array([[1, 2], [3, huge]]))


def strict(step):
    assert (step.after["walked"] == step.after["time"]).all()
    return step.rewards


def test_a_reward_to_learn_from_is_told_the_measures_of_each_step():
    assert next(iterate(SMALL, reward=strict)).metrics["training/length"] > 1


class Flat(torch.nn.Module):
    """A network of somebody's for the arrays that a room shows."""

    def __init__(self, given):
        super().__init__()
        self.both = torch.nn.Linear(18, given.actions + 1)

    def forward(self, seen):
        out = self.both(seen.flatten(1))
        return out[:, :-1], out[:, -1]


@pytest.mark.filterwarnings("ignore:training runs the network")
def test_a_network_of_ones_own_sees_the_arrays_themselves():
    config = replace(SMALL, observation="image", steps=256)
    (last,) = iterate(config, network=Flat)
    assert last.trainer.architecture.shape == (2, 9)


def continuous(**knobs):
    env = Room(**knobs)
    env.action_space = spaces.Box(-1, 1, (2,))
    return env


def colours_first(shape, **knobs):
    env = Room(**knobs)
    env._seen = lambda: np.zeros(shape, np.uint8)
    env.observation_space = spaces.Box(0, 255, shape, np.uint8)
    return env


class Words(spaces.Space):
    """A space that Gymnasium does not know, as that of MiniGrid's missions."""

    def contains(self, x):
        return isinstance(x, str)


SPOKEN = spaces.Dict(said=Words())


def speaking(**knobs):
    env = Room(**knobs)
    env._seen = lambda: {"said": "go"}
    env.observation_space = SPOKEN
    return env


def troubled(make):
    return replace(WORLD, name="troubled", variants=dict.fromkeys(WORLD.variants, make))


@pytest.mark.parametrize(
    "settings, said",
    [
        ({"sampler": "mixed"}, "levels of room are drawn uniformly, .*; got the sampler 'mixed'"),
        ({"art": "original"}, "unknown art 'original' of room; there are: own"),
        ({"teacher": "solver"}, "the game 'room' has no solver"),
        ({"teacher": "mouse"}, "no agent teaches there, .* 'uniform' and the teacher mouse"),
        ({"knobs": {"colour": 3}}, "the factory of room end takes no such knob: .*'colour'"),
        ({"knobs": {"vector": np.arange(1)}}, r"a file of JSON gives back: .*; got array\(\[0\]\)"),
        ({"knobs": {"vector": {1: 2}}}, "the knob 'vector' of a training .*; got {1: 2}"),
        ({"variant": "gone"}, "unknown variant of room 'gone'; there are: end, anywhere"),
        ({"observation": "image", "network": "impala"},
         r"network 'impala' sees images \[H, W, C\] uint8; got torch.float32 of shape \(2, 9\)"),
        ({"game": troubled(partial(colours_first, (12, 14, 14))), "observation": "image",
          "network": "impala"}, r"sees images \[H, W, C\] uint8; got .* of shape \(12, 14, 14\)"),
        ({"game": troubled(partial(colours_first, (3, 40, 36))), "observation": "image",
          "network": "impala"}, r"sees images \[H, W, C\] uint8; got .* of shape \(3, 40, 36\)"),
        ({"game": troubled(continuous)}, "actions must be Discrete or MultiDiscrete; got Box"),
        ({"game": troubled(speaking)}, "of spaces that Gymnasium can flatten, .*; got Dict"),
        ({"game": troubled(partial(Room, trouble="draws"))}, "is another one when it is played"),
        ({"game": troubled(partial(Room, trouble="raises"))}, "its step fails: KeyError"),
        ({"game": troubled(partial(Room, trouble="nan"))},
         "level 0, step 1: its reward must be a finite number; got nan"),
        ({"game": troubled(partial(Room, trouble="text"))}, "a finite number; got 'much'"),
        ({"game": troubled(partial(Room, trouble="vast"))}, "a finite number; got 1000"),
        ({"game": troubled(partial(Room, trouble="word"))},
         "its flag of termination must be True or False; got 'False'"),
        ({"game": troubled(partial(Room, trouble="unsaid"))}, "must be True or False; got None"),
        ({"game": troubled(partial(Room, trouble="spaceless"))},
         "the observation_space of troubled end must be a Space; got None"),
        ({"game": replace(WORLD, name="maze")}, "and no game's; got 'maze'"),
        ({"game": "helpers.rooms:CELLS"}, "a world must be a World; got 9"),
    ],
)  # fmt: skip
def test_what_a_world_cannot_have_is_refused_in_a_sentence(settings, said):
    with pytest.raises(ValueError, match=said):
        next(iterate(replace(SMALL, **{"validation": None, **settings})))


@pytest.mark.waits
@pytest.mark.parametrize(
    "trouble, said",
    [("dies", "the process of an environment"), ("hangs", "did not answer for 2 s")],
)
def test_a_process_that_dies_or_hangs_ends_a_training_with_a_sentence(trouble, said):
    room = troubled(partial(Room, trouble=trouble))
    world = replace(room, workers=True, patience=2.0, repeats=False)
    with pytest.raises(RuntimeError, match=said):
        next(iterate(replace(SMALL, game=world, validation=None)))


class Stream(Room):
    """A Room that chooses its levels itself, by the number of its stream."""

    def __init__(self, stream=0):
        super().__init__()
        self.numbers = np.random.default_rng(stream)

    def reset(self, *, seed=None, options=None):
        seen, _ = super().reset(seed=(level := int(self.numbers.integers(99))))
        return seen, {"number": level}


@pytest.mark.parametrize(
    "more, said",
    [
        ({}, "the episodes begin anew, so the training is another"),
        (
            {"level_key": "number", "variants": {"end": Stream, "anywhere": Stream}},
            "the episodes begin anew, in the first levels of their streams",
        ),
    ],
)
def test_where_levels_do_not_repeat_a_resumed_training_begins_anew_and_says_so(
    more, said, tmp_path
):
    loose = replace(WORLD, name="loose", repeats=False, **more)
    config = replace(SMALL, game=loose)
    next(iterate(config, tmp_path))
    with pytest.warns(UserWarning, match=said):
        resumed = next(iterate(config, tmp_path))
    assert resumed.number == 2


def test_an_agent_of_a_world_is_not_kept_which_is_told_before_it_is_evaluated(run, tmp_path):
    with pytest.raises(ValueError, match=r"agents of games are kept; .* plays the World 'room'"):
        keep(run, "mouse", folder=tmp_path / "kept", levels=10**9)
    assert not [*tmp_path.iterdir()]


def test_an_agent_of_a_world_is_visited_as_a_network_of_it_is(run):
    flat = Network(
        (agent := load_agent(run)).network, Room().observation_space, WORLD,
        lambda net, seen: net(seen.flatten(1)), seed=agent.seed,
    )  # fmt: skip
    (rows, states), (of_network, _) = (visit(one, "anywhere", range(9)) for one in (agent, flat))
    assert rows["value"].is_finite().all() and rows.equals(of_network)
    found = capture(agent, "anywhere", states, ["features.relu1"]).values["features.relu1"]
    others = visit(flat, "anywhere", range(9))[1]
    assert np.array_equal(
        found, capture(flat, "anywhere", others, ["features.relu1"]).values["features.relu1"]
    )


class Counted(Room):
    """A Room that shows integers: where the square is, in the first step alone, and the agent."""

    observation_space = property(lambda env: spaces.Box(0, CELLS, (2,), np.int64), lambda *_: None)

    def _seen(self):
        return np.array([self.square * (self.time == 0), self.x])


def test_a_visit_shows_an_agent_with_memory_scaled_integers_along_its_episodes(tmp_path):
    """Any function that showed them to its network would forget, and most would not scale."""
    counted = replace(WORLD, name="counted", variants={"end": Counted, "anywhere": Counted})
    train(replace(SMALL, game=counted, network="mlp+gru", steps=256), tmp_path, progress=False)
    agent = load_agent(tmp_path)
    rows, states = visit(agent, "anywhere", range(4), batch=3)
    along = capture(agent, "anywhere", states, ["recalled"], episodes=True).values["recalled"]
    k = 0
    for _ in range(4):
        env, state, begins, ended = Counted(), torch.zeros(1, agent.network.memory), True, False
        seen, _ = env.reset(seed=0)
        while not ended:
            shown = torch.from_numpy(seen[None] / np.float32(CELLS)).float()
            with torch.no_grad():
                _, value, state = agent.network.recall(shown, state, torch.tensor([begins]))
            assert rows["value"][k] == pytest.approx(value.item(), abs=1e-5)
            assert np.allclose(along[k], state[0], atol=1e-5)
            seen, _, terminated, truncated, _ = env.step(rows["action"][k])
            k, begins, ended = k + 1, False, terminated or truncated
    assert k == len(rows)


def test_a_file_of_settings_imports_no_world():
    told = SMALL.to_json()
    assert Config.from_json(told) == SMALL and find("room") is WORLD
    with pytest.raises(ValueError, match="unknown game 'os:system'; there are: "):
        Config.from_json(told | {"game": "os:system"})


def test_the_command_line_trains_on_a_world_and_finds_it_again(astray, tmp_path):
    run = tmp_path / "run"
    words = ["--num-envs", "4", "--num-steps", "16", "--minibatches", "1", "--steps", "64"]
    astray("train", "helpers.rooms:WORLD", "end", *words, "--out", str(run))
    last = run / "seed-0"
    (last / "config.json").write_text((last / "config.json").read_text().replace('"room"', '"hut"'))
    assert "unknown game 'hut'; " in (said := astray("evaluate", str(last), fails=True))
    assert "; a World of your own is --world module:WORLD, or" in said
    (last / "config.json").write_text((last / "config.json").read_text().replace('"hut"', '"room"'))
    again = ("evaluate", str(last), "--world", "helpers.rooms:WORLD", "--levels", "500:510")
    told = json.loads(astray(*again, "--json"))
    assert {"end", "anywhere"} >= {row["variant"] for row in told}


@pytest.mark.usefixtures("undrawn")
def test_a_study_trains_agents_on_a_world_in_processes_of_their_own(tmp_path):
    """Its functions have no names, as some in docs/worlds.md, and cannot show images."""
    unnamed = {name: lambda make=make: make() for name, make in WORLD.variants.items()}
    world = replace(WORLD, name="unnamed-rooms", variants=unnamed)
    plan = Plan(
        agents={"mlp": replace(SMALL, game=world, steps=256)},
        tests=spec.tests_of(world, "end"),
        levels=20,
        differences="",
    )
    study = Experiment("Rooms", "nothing", "Where to?", {"smoke": plan}, outcomes.findings)
    page = reproduce(study, "smoke", tmp_path, workers=1)
    told = page.read_text("utf-8")
    assert "reaches “square” first" in told and "none: a video of unnamed-rooms end needs" in told


def test_a_sweep_reads_a_knob_that_is_text_as_a_training_does(astray, tmp_path, monkeypatch):
    """It read a number: the default of `place` is text."""
    swept = []
    monkeypatch.setattr(sweeping, "run_sweep", lambda sweep, *_, **__: swept.append(sweep))
    astray("sweep", "helpers.rooms:WORLD", "end", "--set", "place=1", "--out", str(tmp_path))
    assert [one.knobs for sweep in swept for one in sweep.cells().values()] == [{"place": "1"}]
