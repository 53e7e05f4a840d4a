"""Test levels of a study, which no agent met in training, and the episodes in them."""

import functools
from collections.abc import Iterable
from typing import Any

import numpy as np
import polars as pl
import torch

from astray.acting import check_ending
from astray.analysis.overlap import met, unseen
from astray.analysis.policies import Random
from astray.analysis.runs import play_all, rehearse
from astray.analysis.trained import Agent, Loaded
from astray.experiments.spec import Plan, Runs, Test, open_agents
from astray.game import Variant
from astray.published.imported import SPARED
from astray.training.config import Config
from astray.world import World

met_in = functools.lru_cache(maxsize=1)(met)  # once for all tests of a plan


def levels_of(plan: Plan, test: Test) -> np.ndarray:
    """Return the numbers [N] of a test's levels: the plan's, or those that no agent has met."""
    if plan.first_level is not None:
        return np.arange(plan.first_level, plan.first_level + plan.levels)
    return unmet(plan.agents.values(), test.variant_for(plan.config), plan.levels)


def unmet(agents: Iterable[Config], variant: Variant, count: int) -> np.ndarray:
    """Return the first `count` numbers [count] of a variant's levels that no agent has met.

    Published agents that trained on all two billion levels may have met any level, so these are as
    good as others. ValueError is raised if there are too few.
    """
    agents = list(agents)
    game = agents[0].find_game()
    after = max((config.unseen_levels for config in agents), key=lambda left: left.start)
    if isinstance(game, World) or len(after) <= SPARED:  # a World's levels are not compared
        return np.array(after[:count])
    trainings = tuple((c.training_variant(), c.training_levels) for c in agents)
    try:
        return unseen(game, met_in(game, trainings), variant, after, count)
    except ValueError as error:
        most = max(config.levels for config in agents)
        raise ValueError(f"{error}; lower `levels` of the training, {most:,}") from error


def check_tests(plan: Plan) -> None:
    """Raise ValueError if agents of the plan could not be tested once they are trained.

    A test needs enough levels that no training of the plan meets, episodes that end, and planes of
    the shape that the agents are trained on.
    """
    for test in (*plan.tests.values(), *plan.visited.values()):
        levels_of(plan, test)
    for name, test in plan.tests.items():
        variant = plan.variant_of(test)
        check_ending(plan.game, variant, plan.longest)
        for agent, config in plan.agents.items():
            if config.observation == "symbolic" and not isinstance(plan.game, World):
                planes = plan.game.symbols.planes
                trained, tested = (planes(v).shape for v in (config.training_variant(), variant))
                if trained != tested:
                    raise ValueError(
                        f"{agent} learns from planes {trained}; the test {name!r} has {tested}: "
                        "give both the same world, or window"
                    )


def weights_of(agent: Agent | Loaded) -> bytes:
    """Return the weights of an agent's network; b"" if none is known."""
    found: Any = getattr(getattr(agent, "policy", agent), "network", None)
    network = getattr(found, "network", found)  # of an adapter, whose network is a policy itself
    weights = network.state_dict() if isinstance(network, torch.nn.Module) else {}
    return b"".join(one.numpy(force=True).tobytes() for one in weights.values())


def try_tests(plan: Plan) -> None:
    """Take a random step in each test, and raise the errors of code that is not astray's.

    It is that of measures and rewards, and of a `World`.
    """
    if not plan.measures and not plan.rewards and not isinstance(plan.game, World):
        return
    level = plan.config.unseen_levels.start if plan.first_level is None else plan.first_level
    how: Any = {"measures": plan.measures, "rewards": plan.rewards}
    for test in plan.tests.values():
        rehearse([Random()], plan.game, plan.variant_of(test), [level], **how)


def play(plan: Plan, runs: Runs) -> pl.DataFrame:
    """Play all agents and scripted policies in all tests.

    Columns are those of `analysis.runs.play_all`, and agent (name, null for scripts), test (name)
    and the plan's measures and rewards.

    Raises:
        ValueError: If two agents of a name have the same weights.
    """
    opened = open_agents(plan, runs)
    for name, made in opened.items():  # files may differ all the same, as they have a date
        known = [told for told in map(weights_of, made) if told]
        if len({*known}) < len(known):
            told = f"two of {', '.join(map(str, runs[name]))} are one agent, of equal weights"
            mend = "let each training use a seed, and `load` return a network, of its own"
            raise ValueError(f"{told}; {mend}")
    players = [player for made in opened.values() for player in made]
    owners = pl.DataFrame(
        [{"run": str(run), "agent": name} for name, made in runs.items() for run in made]
    )
    how: Any = {"measures": plan.measures, "rewards": plan.rewards}
    levels = {name: levels_of(plan, test) for name, test in plan.tests.items()}
    for name, test in plan.tests.items():  # all of them before the first is played
        rehearse(players, plan.game, plan.variant_of(test), levels[name], **how)
    parts = []
    for name, test in plan.tests.items():
        variant = plan.variant_of(test)
        given = (variant, test.shift, levels[name], players)
        played = play_all(plan.game, test.name, *given, longest=plan.longest, **how)
        parts.append(played.with_columns(test=pl.lit(name)))
    return pl.concat(parts).join(owners, on="run", how="left", maintain_order="left")
