"""Drop-in replacements for Procgen's interfaces: change the import and nothing else.

    from astray.compat import ProcgenEnv  # was: from procgen import ProcgenEnv

With the same `rand_seed`, levels, images, rewards, ends and infos equal those of Procgen 0.10.7
byte for byte. The original pictures have to be imported once: astray art import.
"""

from __future__ import annotations

import secrets
import sys
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.kernel.grid import ACTIONS
from astray.record import LEVELS
from astray.validation import MOST, bounded, check_words, integers, of_kind, one_of

Mode = Literal["easy", "hard", "memory", "exploration"]
# Observations, rewards, ends and infos.
Taken = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]
EXPLORATION = {  # the one level of that mode
    "coinrun": 1949448038, "maze": 158988835, "heist": 876640971,
}  # fmt: skip
COMBOS = [() if name == "stay" else tuple(name.upper().split("-")) for name in ACTIONS]
PICTURED = (
    "center_agent", "use_backgrounds", "use_monochrome_assets", "restrict_themes",
    "use_generated_assets", "paint_vel_info",
)  # fmt: skip  # options that change pictures
FORCE_RESET = -1  # an action
ONWARD = 997  # from a sequential level that was completed to the next
WORD = 2**32


@dataclass(frozen=True, kw_only=True)
class Options:
    """Procgen's options. Those that change pictures accept only their default.

    Attributes:
        num_levels: Number of levels from start_level on; 0 for all.
        rand_seed: Decides the order of levels and nothing else; None for a random order.
        num_threads: Threads that share the batch, 0 or 1 for one; results do not depend on it.
        art: Art of the images: the original's, or "own", which needs no import.
    """

    distribution_mode: Mode = "hard"
    num_levels: int = 0
    start_level: int = 0
    use_sequential_levels: bool = False
    rand_seed: int | None = None
    num_threads: int = 4
    art: str = "original"
    center_agent: bool = True
    use_backgrounds: bool = True
    use_monochrome_assets: bool = False
    restrict_themes: bool = False
    use_generated_assets: bool = False
    paint_vel_info: bool = False
    render_mode: Literal["rgb_array"] | None = None

    def __post_init__(self) -> None:
        check_words(self)
        bounded("start_level", self.start_level, 0, LEVELS.stop - 1)
        bounded("num_levels", self.num_levels, 0, LEVELS.stop - self.start_level)
        bounded("num_threads", self.num_threads, 0, MOST)
        bounded("rand_seed", self.rand_seed or 0, 0, 2**31 - 1)
        for name in PICTURED:
            given, only = getattr(self, name), getattr(Options, name)
            if given != only:
                told = f"{name} must be {only}, as other pictures are not drawn"
                raise ValueError(f"{told}; got {given}")

    def levels(self, name: str) -> range:
        """Return the levels to draw from.

        Raises:
            ValueError: If the range exceeds the game's levels.
        """
        if self.distribution_mode == "exploration":
            if name not in EXPLORATION or self.num_levels or self.start_level:
                raise ValueError(
                    "distribution_mode 'exploration' is one level of coinrun, maze or heist; give "
                    "neither num_levels nor start_level"
                )
            return range(EXPLORATION[name], EXPLORATION[name] + 1)
        if not self.num_levels:
            return LEVELS
        return range(self.start_level, self.start_level + self.num_levels)


class ProcgenGym3Env:
    """`num` environments of Procgen's game `env_name`, with gym3's methods.

    Args:
        env_name: coinrun, maze or heist, or any game and variant of astray, such as "maze/corner".
        options: See `Options`.

    Raises:
        ValueError: If there is no such game or option.
    """

    def __init__(self, num: int, env_name: str, **options: Any):
        for name in options:
            one_of("option", name, Options.__dataclass_fields__)
        chosen = Options(**options)
        game, variant = world(env_name, chosen.distribution_mode)
        self.num, self.env_name, self.options = num, env_name, chosen
        self.env = GameVectorEnv(
            game,
            variant,
            num,
            art=chosen.art,
            autoreset_mode="Disabled",
            threads=max(1, min(chosen.num_threads, num)),
            render_mode=chosen.render_mode,
        )
        if "stay" not in self.env.game.actions:
            raise ValueError(f"{env_name} must have an action to stay, for episodes that are left")
        self._stay = self.env.game.actions.index("stay")
        self.combos = COMBOS
        self.levels = chosen.levels(env_name)
        seed = secrets.randbelow(2**31) if chosen.rand_seed is None else chosen.rand_seed
        one = np.random.RandomState(seed)
        self._draws = [np.random.RandomState(_word(one)) for _ in range(num)]
        self.ob_space = spaces.Dict(rgb=self.env.single_observation_space)
        self.ac_space = self.env.single_action_space
        self._level = np.array([self._drawn(i) for i in range(num)], np.int32)
        self._before = np.zeros(num, np.int32)
        self._complete = np.zeros(num, np.uint8)
        self._reward, self._first = np.zeros(num, np.float32), np.ones(num, bool)
        self._seen, _ = self.env.reset(seed=0, options={"level": self._level})
        goals, over = self.env.game.event_goals, self.env.game.shifts.values()
        self._goals = sorted({goals[s.intended] for s in over if s.intended in goals})

    def observe(self) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
        """Return rewards [num] float32 of the last step, observations, first-step flags [num]."""
        return self._reward, {"rgb": self._seen}, self._first

    def get_info(self) -> list[dict[str, Any]]:
        """Return prev_level_seed, prev_level_complete and level_seed of each environment."""
        return [
            {"prev_level_seed": before, "prev_level_complete": complete, "level_seed": level}
            for before, complete, level in zip(
                self._before, self._complete, self._level, strict=True
            )
        ]

    def act(self, ac: Any) -> None:
        """Take a step; -1 leaves an episode. Ended episodes restart at once."""
        actions = integers(ac, "actions").astype(np.int64)
        forced = actions == FORCE_RESET
        self._seen, reward, terminated, truncated, _ = self.env.step(
            np.where(forced, self._stay, actions)
        )
        self._reward = reward.astype(np.float32)
        done = terminated | truncated | forced
        now = self.env.states["time"]
        reached = np.any([self.env.states[goal] == now for goal in self._goals], axis=0)
        complete = terminated & reached
        self._complete, self._before = complete.astype(np.uint8), self._level.copy()
        if done.any():
            self._begin(done, complete)
        self._first = done & ~complete if self.options.use_sequential_levels else done

    def _begin(self, which: np.ndarray, complete: np.ndarray) -> None:
        """Begin another level in the environments `which`, [num] bool."""
        for i in np.flatnonzero(which).tolist():
            onward = self.options.use_sequential_levels and complete[i]
            after = (int(self._level[i]) + ONWARD) % LEVELS.stop  # there are no others
            self._level[i] = after if onward else self._drawn(i)
        begun = {"level": self._level.astype(np.int64), "reset_mask": which}
        seen, _ = self.env.reset(options=begun)
        self._seen = np.where(which[:, None, None, None], seen, self._seen)

    def _drawn(self, i: int) -> int:
        """Draw the next level of environment `i`: a random word modulo the number of levels."""
        return self.levels.start + _word(self._draws[i]) % len(self.levels)

    def callmethod(self, method: str, *args: Any, **kwargs: Any) -> Any:
        """Call a further method of gym3 by its name; states are records, as in `env.get_state`.

        Raises:
            ValueError: If there is no such method.
        """
        raise ValueError(
            f"there is no method {method!r} here; states are had from .env.get_state(), and set "
            "with .env.set_state(states)"
        )

    def close(self) -> None:
        self.env.close()


class ProcgenEnv:
    """Procgen's environments as OpenAI's Baselines and CleanRL use them, with dicts and info lists.

    It takes all options of `ProcgenGym3Env`. `reset` only returns the current observations,
    because Procgen begins episodes by itself. Spaces are those of old gym if the script has
    imported it, otherwise Gymnasium's.
    """

    reward_range, metadata, spec = (-float("inf"), float("inf")), {"render_modes": []}, None

    def __init__(self, num_envs: int, env_name: str, **options: Any):
        self.gym3 = ProcgenGym3Env(num_envs, env_name, **options)
        self.num_envs = num_envs
        # Scripts ask whether spaces are old gym's, as Procgen's are; others have only Gymnasium's.
        kinds = sys.modules.get("gym.spaces", spaces)
        box, count = self.gym3.env.single_observation_space, len(self.gym3.env.game.actions)
        self.observation_space = kinds.Dict(rgb=kinds.Box(0, 255, box.shape, np.uint8))
        self.action_space = kinds.Discrete(count)

    @property
    def unwrapped(self) -> ProcgenEnv:
        return self

    def reset(self) -> dict[str, np.ndarray]:
        """Return the current observations, {"rgb": [num_envs, 64, 64, 3] uint8}."""
        return self.gym3.observe()[1]

    def step_async(self, actions: Any) -> None:
        """Take a step; `step_wait` returns its result."""
        self.gym3.act(actions)

    def step_wait(self) -> Taken:
        """Return observations, rewards, ends [num_envs] bool and infos of the last step."""
        reward, seen, first = self.gym3.observe()
        return seen, reward, first, self.gym3.get_info()

    def step(self, actions: Any) -> Taken:
        """Take a step and return observations, rewards [num_envs], ends [num_envs] and infos."""
        self.step_async(actions)
        return self.step_wait()

    def render(self, mode: str = "rgb_array") -> np.ndarray:
        """Return pictures to look at, [num_envs, 512, 512, 3] uint8."""
        return self.gym3.env.picture(512)

    def seed(self, seed: int | None = None) -> None:
        """Do nothing, as in Procgen: `rand_seed` decides."""

    def close(self) -> None:
        self.gym3.close()


def world(env_name: str, mode: Mode) -> tuple[str, str]:
    """Return astray's game and variant for Procgen's name and distribution mode.

    Raises:
        ValueError: If there are none.
    """
    of_kind("env_name", env_name, str)
    if "/" in env_name:
        game, _, variant = env_name.partition("/")
        if mode != "hard":
            raise ValueError(f"{env_name} is one difficulty; distribution_mode must be left out")
        return game, variant
    known = games.PROCGEN.get((env_name, "hard" if mode == "exploration" else mode))
    if known is None:
        there = ", ".join(f"{name} {of}" for name, of in games.PROCGEN)
        raise ValueError(
            f"{env_name} {mode} of Procgen is not here; there are: {there}; and astray's own, as "
            "maze/corner"
        )
    return known


def _word(generator: np.random.RandomState) -> int:
    """Return the next 32 bits of a Mersenne Twister."""
    return int(generator.randint(WORD, dtype=np.uint32))
