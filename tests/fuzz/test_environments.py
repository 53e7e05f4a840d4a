"""Environments are driven in any order, beside one that does each turn alone."""

from dataclasses import replace

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.level import Level
from helpers.anything import GAMES, MORE, QUIET, tried


class Environments(RuleBasedStateMachine):
    """Resets, steps, masks, states and edited levels in any order, beside a second environment.

    The second never shares a batch with others, and is restored from the first's states at every
    turn: what it does must be the same.
    """

    @initialize(
        game=st.sampled_from(GAMES),
        mode=st.sampled_from(["SameStep", "Disabled", "NextStep"]),
        seed=st.integers(0, 2**40),
        threads=st.integers(1, 2),
        pick=st.integers(0, 99),
    )
    def begin(self, game, mode, seed, threads, pick):
        made = games.find(game)
        kind = list(made.variants.values())[pick % len(made.variants)]
        kind = replace(kind, time_limit=7)
        options = {"autoreset_mode": mode, "observation": "symbolic"}
        self.mode, self.game = mode, made
        self.env = GameVectorEnv(game, kind, 3, threads=threads, **options)
        self.alone = GameVectorEnv(game, kind, 1, **options)
        self.seen, _ = self.env.reset(seed=seed)
        self.kept = self.env.get_state()

    @rule(
        seed=st.none() | st.integers(0, 2**40),
        level=st.none() | st.integers(0, 2**31 - 2),
        mask=st.lists(st.booleans(), min_size=3, max_size=3),
    )
    def reset(self, seed, level, mask):
        options = {"reset_mask": np.array(mask)} | ({} if level is None else {"level": level})
        before = self.env.get_state()
        self.seen, _ = self.env.reset(seed=seed, options=options)
        for k in range(3):
            if not mask[k]:
                assert self.env.states[k].tobytes() == before[k].tobytes()
            elif level is not None:
                assert self.env.states[k].level == level and self.env.states[k].time == 0
        tried("turns of environments", 0)

    @precondition(lambda self: not (self.mode == "Disabled" and self.env.states.ended.any()))
    @rule(seed=st.integers(0, 2**32))
    def step(self, seed):
        actions = np.random.default_rng(seed).integers(len(self.game.actions), size=3)
        before = self.env.get_state()
        self.seen, reward, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        assert not (terminated & truncated).any() and np.isfinite(reward).all()
        if ended.any() and self.mode == "SameStep":
            assert (info["final_info"]["time"][ended] <= 7).all()
        for k in range(3):
            self.alone.set_state(before[k])
            seen, *told, _ = self.alone.step(actions[k : k + 1])
            assert seen[0].tobytes() == self.seen[k].tobytes()
            assert [x[0] for x in told] == [reward[k], terminated[k], truncated[k]]
        tried("turns of environments", 0)

    @rule()
    def keep(self):
        self.kept = self.env.get_state()

    @rule()
    def go_back(self):
        self.seen = self.env.set_state(self.kept)
        assert self.env.get_state().tobytes() == self.kept.tobytes()
        tried("turns of environments", 0)

    @rule(name=st.integers(0, 9), place=st.integers(0, 10**6), mask=st.integers(1, 7))
    def edit(self, name, place, mask):
        which = np.array([bool(mask >> k & 1) for k in range(3)])
        first = int(which.argmax())
        self.env.reset(options={"reset_mask": which})
        level = Level.of(self.game, self.env.variant, self.env.states[first])
        there = [n for n in ("agent", *self.game.editing.OBJECTS) if n == "agent" or level.where(n)]
        name = there[name % len(there)]
        family = level.splay(name, level.where(name)[0] if name != "agent" else None)
        edited = family[place % len(family)]
        self.seen, _ = self.env.reset(options={"level": edited, "reset_mask": which})
        now = Level.of(self.game, self.env.variant, self.env.states[first])
        assert str(now) == str(edited)
        tried("turns of environments", 0)

    @invariant()
    def all_is_well(self):
        if hasattr(self, "env"):
            assert self.seen in self.env.observation_space
            self.game.check(self.env.states, self.env.variant)

    def teardown(self):
        if hasattr(self, "env"):
            self.env.close()


TestEnvironments = Environments.TestCase
TestEnvironments.settings = settings(max_examples=6 * MORE, stateful_step_count=15, **QUIET)
