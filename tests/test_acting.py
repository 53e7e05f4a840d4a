"""The one loop in which policies play, beside an environment stepped by hand."""

from collections import namedtuple
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from astray import games
from astray.acting import Answer, Asking, Onward, Turn, initial_states, play, steps
from astray.analysis.critic import ask
from astray.analysis.evaluate import evaluate
from astray.analysis.policies import Random, Walk
from astray.analysis.trained import Opaque
from astray.envs.vector import GameVectorEnv

GAME, VARIANT = "maze", "anywhere-small"
LEVELS = np.array([3, 17, 4, 100_000, 5, 6, 2, 900, 41, 77, 12])


def by_hand(policy, level):
    """The places of one episode of `policy`, in an environment of its own."""
    env = GameVectorEnv(GAME, VARIANT, observation="symbolic", autoreset_mode="Disabled")
    seen, _ = env.reset(seed=5, options={"level": int(level)})
    places, over = [], False
    while not over:
        seen, _, terminated, truncated, _ = env.step(policy.actions(Turn.of(env, seen)).actions)
        places.append((int(env.states.x[0]), int(env.states.y[0])))
        over = terminated[0] or truncated[0]
    return places


@pytest.mark.parametrize("batch", [1, 4, 11, 256])
@pytest.mark.parametrize("make", [Random, lambda: Walk("cheese")], ids=["random", "walk"])
def test_each_level_is_played_once_as_by_hand_in_any_batch(make, batch):
    places = [[] for _ in LEVELS]
    for step in steps(make(), GAME, VARIANT, LEVELS, batch=batch):
        assert len(set(step.level.tolist())) == len(step.level)
        assert (step.before["time"] + 1 == step.after["time"]).all()
        for k, s in zip(step.level, step.after, strict=True):
            places[k].append((int(s["x"]), int(s["y"])))
    assert places == [by_hand(make(), level) for level in LEVELS]


@dataclass
class Watching:
    """A walk to the cheese that remembers how many observations it was shown at a time."""

    name: str = "watching"
    observation: str = "symbolic"
    art: str = "own"
    shown: list = field(default_factory=list)
    walk: Walk = field(default_factory=lambda: Walk("cheese"))

    def actions(self, turn):
        self.shown.append(len(turn.observations))
        return self.walk.actions(turn)


def test_who_goes_on_when_most_have_ended_is_alone():
    policy = Watching()
    episodes = evaluate(policy, GAME, VARIANT, LEVELS)
    longest = episodes["length"].max()
    assert len(policy.shown) == longest
    assert policy.shown[0] == len(LEVELS)
    live = [int((episodes["length"] > k).sum()) for k in range(longest)]
    assert all(
        n <= shown < 2 * max(n, 1) or shown == n
        for n, shown in zip(live, policy.shown, strict=True)
    )
    assert policy.shown[-1] < len(LEVELS) / 2


def test_an_episode_is_left_with_the_first_event_it_is_played_until():
    whole = evaluate(Walk("corner"), GAME, VARIANT, LEVELS)
    until = evaluate(Walk("corner"), GAME, VARIANT, LEVELS, until=["reached_corner"])
    first = whole["reached_corner"].fill_null(whole["length"]).clip(1)  # some begin there
    assert (whole["length"] > first).any(), "nothing happens after it"
    assert until["length"].to_list() == first.to_list()
    assert until["reached_corner"].to_list() == whole["reached_corner"].to_list()
    assert until.filter(until["length"] < whole["length"])["terminated"].sum() == 0


class Counting:
    """Goes by how many steps of its episode it remembers; `memory` says in which form."""

    name, observation, art = "counting", "symbolic", "own"

    def __init__(self, form=lambda steps: steps, read=lambda memory: memory):
        self.form, self.read = form, read

    def actions(self, turn):
        n = len(turn.begins)
        before = np.zeros(n, int) if turn.memory is None else self.read(turn.memory)
        steps = np.where(turn.begins, 0, before) + 1
        assert (steps == turn.env.states["time"] + 1).all(), "of another episode"
        return Answer(7 * steps % 15, self.form(steps), {"remembers": steps})


Memory = namedtuple("Memory", "steps other")


@pytest.mark.parametrize("batch", [1, 5, 256])
@pytest.mark.parametrize(
    "form, read",
    [
        (lambda x: x, lambda x: x),
        (lambda x: {"a": (None, x)}, lambda x: x["a"][1]),
        (lambda x: [torch.from_numpy(x)], lambda x: x[0].numpy()),
        (lambda x: Memory(x, None), lambda x: x.steps),
    ],
    ids=["array", "nested", "tensor", "named"],
)
def test_memory_follows_its_episode_in_any_batch(form, read, batch):
    for step in steps(Counting(form, read), GAME, VARIANT, LEVELS, batch=batch):
        assert (step.extra["remembers"] == step.after["time"]).all()
        assert (step.actions == 7 * step.extra["remembers"] % 15).all()


@pytest.mark.parametrize(
    "form",
    [
        lambda x: np.stack([x, x]),  # by layer, as torch's LSTM has it
        lambda x: (x, np.append(x, 0)),
        lambda x: x.tolist(),
        lambda x: {"steps": x, "layers": 3},
    ],
    ids=["layers first", "too long", "list", "number"],
)
def test_memory_that_is_not_a_row_for_each_episode_is_refused(form):
    with pytest.raises(ValueError, match="memory must be arrays or tensors of 5 rows, one per"):
        list(steps(Counting(form), GAME, VARIANT, LEVELS, batch=5))


def test_episodes_go_on_from_where_they_are_until_one_ends():
    env = GameVectorEnv(GAME, VARIANT, 3, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0)
    env.step(np.zeros(3, int))
    played = list(play(Asking(Random()), Onward(env, env.set_state(env.get_state()))))
    assert (played[0].before["time"] == 1).all() and played[-1].ended.any()
    assert not any(step.ended.any() for step in played[:-1])
    assert not [*play(Asking(Random()), Onward(env, played[-1].seen))]


class Groups:
    """Two groups of one environment, that show how often they were stepped."""

    groups = (0, 1)

    def __init__(self, said):
        self.said, self.times = said, [0, 0]

    def begin(self, group):
        return Turn(None, self.times[group], np.zeros(1, bool))

    def step(self, t, group, answer):
        self.said.append(f"step {t} of {group}")
        self.times[group] += 1
        return t, group, answer


class Sent:
    def __init__(self, said):
        self.said = said

    def send(self, t, group, turn):
        self.said.append(f"send {t} of {group}")
        assert turn.observations == t

    def receive(self, group):
        return Answer(np.zeros(1, int))


def test_one_group_is_sent_for_while_another_steps():
    said = []
    assert len([*play(Sent(said), Groups(said), 2)]) == 4
    assert said == [
        "send 0 of 0", "send 0 of 1", "step 0 of 0", "send 1 of 0", "step 0 of 1", "send 1 of 1",
        "step 1 of 0", "send 2 of 0", "step 1 of 1", "send 2 of 1",
    ]  # fmt: skip


def test_an_unknown_event_is_told():
    with pytest.raises(ValueError, match="unknown event 'corner' of maze; there are: "):
        next(steps(Random(), GAME, VARIANT, LEVELS, until=["corner"]))


def test_initial_states_are_those_that_episodes_begin_in():
    begun = initial_states(GAME, VARIANT, range(2050))
    assert begun.level.tolist() == list(range(2050))
    env = GameVectorEnv(GAME, VARIANT, 3)
    chosen = [0, 1000, 2049]
    env.reset(seed=0, options={"level": np.array(chosen)})
    tell = games.find(GAME).editing.describe
    assert [tell(s) for s in begun[chosen]] == [tell(s) for s in env.states]


@pytest.mark.parametrize("wrong", [-1, 99, 7.0, True, [7], None, 2**63])
def test_what_is_no_action_is_refused_also_where_nothing_is_played(wrong):
    """-1 was shown as the last action in the lab, and 99 was a mistake of numpy's."""
    game = games.find("maze")
    states = np.array(list(initial_states(game, "corner-small", range(3))), game.state)
    policy = SimpleNamespace(
        name="odd", observation="symbolic", art="own",
        actions=lambda turn: Answer(np.array([wrong] * len(turn.begins))),
    )  # fmt: skip
    told = r"odd must (return integers \[3\]|be from 0 to 14)"
    for asked in (
        lambda: ask(Opaque(policy, "maze"), "corner-small", states),
        lambda: evaluate(policy, "maze", "corner-small", range(3)),
    ):
        with pytest.raises(ValueError, match=told):
            asked()
