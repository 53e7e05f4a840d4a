"""Evaluation of trained agents beside the base rates of scripted policies."""

import itertools
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import polars as pl
import torch

from astray import world
from astray.acting import Levels, Policy, Reward, check_ending, check_policy
from astray.agents.policy import check_known, usable, weights
from astray.analysis.evaluate import Measure, evaluate
from astray.analysis.outcomes import (
    label,
    load_shift,
    mark_distinguishing,
    name_of,
    outcomes_of,
    rates,
)
from astray.analysis.policies import scripts_of
from astray.analysis.results import ALL, APART, Result
from astray.analysis.trained import Agent, Loaded
from astray.envs.worlds import Unreported, unreported
from astray.game import Game, Shift, Variant
from astray.level_files import read_levels
from astray.training import folders
from astray.training.config import Config
from astray.training.folders import AgentFolder
from astray.validation import of_kind, shown
from astray.world import World, WorldVariant

LEVELS_PLAYED = 1000  # default number of levels
NAMED = 3  # agents of a pooled row that are named one by one
Mode = Literal["sampled", "greedy"]


def open_run(
    run: str | Path, mode: Mode = "sampled", art: str | None = None
) -> tuple[Agent, Config]:
    """Return the agent and the settings of its training; raise the errors of `load_agent`."""
    found = AgentFolder.open(run)
    config = found.config()
    device = config.device if usable(config.device) else "cpu"
    shown = config.art if art is None else art
    config.find_game().drawn(shown, None if art is None else config.training_variant())
    while True:
        try:
            agent = Agent(found.weights, config.game, mode, config.seed, device, shown)
            check_known(agent.path, agent.architecture, **config.sizes)
            return agent, config
        except FileNotFoundError:  # a training removes older checkpoints
            if found == (found := AgentFolder.open(run)):
                raise


def load_agent(run: str | Path, mode: Mode = "sampled", art: str | None = None) -> Agent:
    """Load the agent of a run folder or checkpoint, or a pretrained or imported one by name.

    Examples:
        >>> agent = astray.load_agent("maze-corner")
        >>> agent.outputs(np.zeros((1, *agent.space.shape), np.uint8))[0].shape
        torch.Size([1, 15])

    Args:
        mode: "sampled" samples actions from the policy, "greedy" takes the most likely.
        art: Art of its observations; None for that of its training.

    Raises:
        FileNotFoundError: If there is no such agent.
        ValueError: If its files are damaged or cannot be used.
    """
    return open_run(run, mode, art)[0]


def shift_of(config: Config | None, game: Any = None) -> str:
    """Return the shift whose training variant the run used, or else the test variant.

    An agent trained on the test variant of others is their control. A policy without a run has the
    only shift of its `game`.

    Raises:
        ValueError: If no shift has the run's variant, or there are several for a policy.
    """
    if config is None:
        if len(game.shifts) != 1:
            there = ", ".join(game.shifts) or "none"
            raise ValueError(f"a policy needs a shift of {game.name} by name; there are: {there}")
        return next(iter(game.shifts))
    game = config.find_game()
    shifts = game.shifts.items()
    found = [name for name, shift in shifts if shift.train == config.variant]
    found += [name for name, shift in shifts if shift.test == config.variant]
    if not found:
        raise ValueError(
            f"no shift of {config.game} trains on {config.variant!r}, or tests on it; "
            f"name one of: {', '.join(game.shifts) or 'none, as it has no shifts'}"
        )
    return found[0]


def evaluate_runs(
    runs: Sequence[str | Path],
    levels: np.ndarray | Path | None = None,
    *,
    variant: str | Variant | None = None,
    shift: str | Shift | None = None,
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: dict[str, Any] | None = None,
    batch: int = 256,
    solvable: bool = True,
    longest: int | None = None,
    rewards: Mapping[str, Reward] | None = None,
    pool: bool = False,
) -> Result:
    """Evaluate agents beside scripted policies that know only one goal, or none.

    Examples:
        >>> result = astray.evaluate_runs(["maze-corner"], range(200_000, 200_100))
        >>> result.agents
        ('maze-corner',)

    Args:
        runs: Run folders, checkpoints in them, or names of pretrained or imported agents.
        levels: Level numbers, or a file or folder for `read_levels`; None for the first 1,000
            outside of all runs' training levels.
        variant: Name of a variant, or a `Variant`; None for the shift's test variant.
        shift: Name of a shift, or a `Shift`; None for the one of the runs' training.
        art: Art of the observations; None for that of the training, which must be common.
        solvable: Check that every object can be reached in levels from files.
        longest: Steps after which an episode is truncated; None for no limit.
        rewards: Further rewards of the same episodes, as for `evaluate`.
        pool: Treat the agents, each of a training of its own, as one kind, in a single row.

    Raises:
        ValueError: If runs differ in kind or occur twice, or there are no levels.
        FileNotFoundError: If there is no such run.

    Warns:
        LeftOut: If the variant lacks knobs of the training.
    """
    if isinstance(runs, str) or not isinstance(runs, Sequence) or not runs:
        raise ValueError(f"runs must be a list of run folders; got {shown(runs)}")
    opened = [open_run(run, mode, art) for run in runs]
    config = opened[0][1]
    files = [weights(one.network, one.architecture, one.game) for one, _ in opened]
    folders_of = [os.path.realpath(one.origin[0]) for one, _ in opened]
    for k, file in enumerate(files):  # a duplicate would make intervals too narrow
        if (first := files.index(file)) < k:
            raise ValueError(f"{runs[first]} and {runs[k]} are the same agent; give it once")
        if pool and (first := folders_of.index(folders_of[k])) < k:
            told = f"must be of several trainings; {runs[first]} and {runs[k]} are of one"
            raise ValueError(f"agents in a single row {told}")
    for run, (_, other) in zip(runs, opened, strict=True):
        for name in ("game", "variant", "knobs", *(["art"] if art is None else [])):
            if (mine := getattr(config, name)) != (its := getattr(other, name)):
                raise ValueError(
                    f"agents evaluated together must share the {name} of their training: "
                    f"{runs[0]} has {mine}, {run} has {its}"
                )
    named, game = shift_of(config) if shift is None else shift, config.find_game()
    played = load_shift(game, named).test if variant is None else variant
    if levels is None:
        after = max((other.unseen_levels for _, other in opened), key=lambda left: left.start)
        levels = np.array(after[:LEVELS_PLAYED])
    agents = [agent for agent, _ in opened]
    changed = config.played_variant(played, knobs)
    how: Any = {"batch": batch, "longest": longest, "rewards": rewards}
    how["names"] = names_of(agents, pool)
    return _outcomes(agents, game, name_of(played), changed, named, levels, solvable, **how)


def names_of(policies: Sequence[Policy], pool: bool = False) -> list[str]:
    """Return the name of each policy in tables; agents have those of their folders."""
    found = {str(one.path): AgentFolder.of(one.path) for one in policies if isinstance(one, Agent)}
    runs, names = [its.path for its in found.values()], []
    for one in policies:
        check_policy(one)
        name = one.name
        if isinstance(one, Agent):
            its = found[str(one.path)]
            name = folders.name_of(its.path)
            if runs.count(its.path) > 1 or its.is_older:  # not just the run's agent
                name += f" at {its.steps:,} steps"
            if one.mode == "greedy":
                name += " (greedy)"
        names.append(name)
    if pool and len(names) > 1:
        return [", ".join(names) if len(names) <= NAMED else f"{len(names)} agents"] * len(names)
    return names


def evaluate_policies(
    policies: Sequence[Policy],
    game: str | Game | World,
    shift: str | Shift,
    levels: np.ndarray | range | Path | None = None,
    *,
    variant: str | Variant | WorldVariant | None = None,
    knobs: dict[str, Any] | None = None,
    batch: int = 256,
    solvable: bool = True,
    longest: int | None = None,
    rewards: Mapping[str, Reward] | None = None,
) -> Result:
    """Evaluate any policies as `evaluate_runs` does trained agents.

    By default the first 1,000 levels are played. In a `World`, scripts are its experts, and knobs
    are arguments of its factories.

    Raises:
        ValueError: If an argument is invalid, or `levels` is a file for a `World`.

    Examples:
        >>> right = astray.Function(lambda images: np.full(len(images), 7), name="right")
        >>> result = astray.evaluate_policies([right], "maze", "corner", range(20))
        >>> result.agents
        ('right',)
    """
    game = world.find(game)
    wanted: Any = load_shift(game, shift).test if variant is None else variant
    played = range(LEVELS_PLAYED) if levels is None else levels
    changed = game.variant(wanted).with_knobs({} if knobs is None else knobs)
    of_kind("policies", policies, Sequence)
    how: Any = {"batch": batch, "longest": longest, "rewards": rewards, "names": names_of(policies)}
    return _outcomes(policies, game, name_of(wanted), changed, shift, played, solvable, **how)


def _outcomes(
    policies: Sequence[Policy],
    game: Game | World,
    name: str,
    variant: Variant | WorldVariant,
    shift: str | Shift,
    levels: np.ndarray | range | Path,
    solvable: bool,
    **how: Any,
) -> Result:
    chosen: Any = levels
    if isinstance(levels, Path):
        if isinstance(game, World) or isinstance(variant, WorldVariant):
            raise ValueError(f"levels of {game.name} are numbers; got the file {levels}")
        chosen = read_levels(levels, game, variant, solvable=solvable)
        known: dict[bytes, str] = {}
        for one, level in chosen.items():  # intervals would count it as several
            if (first := known.setdefault(level.state(solvable=False).tobytes(), one)) != one:
                raise ValueError(f"{first} and {one} in {levels} are one level; give it once")
    episodes = play_all(game, name, variant, shift, chosen, policies, trial=True, **how)
    return rated(episodes, game, load_shift(game, shift), [*dict.fromkeys(how["names"])])


def rated(
    episodes: pl.DataFrame, game: Game | World, shift: Shift, agents: Sequence[str]
) -> Result:
    """Return episodes of `play_all` with the rates of their outcomes, and the agents' names."""
    both = [
        rates(part, outcomes=outcomes_of(game)).with_columns(levels_played=pl.lit(which))
        for which, part in ((ALL, episodes), (APART, episodes.filter("distinguishing")))
        if len(part)
    ]
    return Result(pl.concat(both), episodes, (*agents,), shift)


def rehearse(
    policies: Sequence[Policy],
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    levels: Levels,
    **how: Any,
) -> None:
    """Play a step of each policy, and raise its error before the work; `how` is as in `evaluate`.

    Torch's random state, from which policies may draw, stays unchanged.
    """
    first: Any = levels[:1] if isinstance(levels, Sequence | np.ndarray) else levels
    if isinstance(levels, Mapping):
        first = dict(itertools.islice(levels.items(), 1))
    unsaid = warnings.catch_warnings(action="ignore", category=Unreported)
    with torch.random.fork_rng(devices=[]), unsaid:
        for policy in policies:
            evaluate(policy, game, variant, first, longest=1, **how)


def play_all(
    game: Game | World,
    name: str,
    variant: Variant | WorldVariant,
    shift: str | Shift,
    levels: Levels,
    policies: Sequence[Policy],
    batch: int = 256,
    measures: Mapping[str, Measure] | None = None,
    longest: int | None = None,
    rewards: Mapping[str, Reward] | None = None,
    names: Sequence[str] | None = None,
    trial: bool = False,
) -> pl.DataFrame:
    """Play policies, and scripts that walk to each goal or at random.

    Without a solver, the only script is random. The columns are those of `evaluate`, and run,
    seed, checkpoint (null for scripts), variant (its `name`), outcome, distinguishing.

    Args:
        names: Name of each policy in the table; None for their own.
        trial: Rehearse the policies after these checks.

    Raises:
        ValueError: If an argument is invalid, or two policies have one name.
    """
    of_kind("policies", policies, Sequence)
    for policy in policies:
        check_policy(policy)
    between = load_shift(game, shift)
    given = {(type(one), one.name) for one in policies}  # of them a script may be one
    scripts = [one for one in scripts_of(game, between) if (type(one), one.name) not in given]
    called = [*(one.name for one in scripts), *(names or [one.name for one in policies])]
    players = [*scripts, *policies]
    # A name may be of several agents of one kind, and episodes of one name are counted together.
    each = [
        (name, one.origin if isinstance(one, Agent | Loaded) else None)
        for name, one in zip(called, players, strict=True)
    ]
    alone = {name for name, origin in each if origin is None}
    if len({*each}) < len(each) or any(origin and name in alone for name, origin in each):
        raise ValueError(f"policies must have names of their own; got {', '.join(called)}")
    check_ending(game, variant, longest)
    how: Any = {"batch": batch, "measures": measures, "rewards": rewards}
    rehearse(policies if trial else (), game, variant, levels, **how)
    with warnings.catch_warnings(action="ignore", category=Unreported):  # by one policy alone
        tables = [evaluate(one, game, variant, levels, longest=longest, **how) for one in players]
    if told := unreported(game):
        raise ValueError(told)
    parts = [
        table.with_columns(
            policy=pl.lit(its_name),
            run=pl.lit(run, pl.String),
            seed=pl.lit(seed, pl.Int64),
            checkpoint=pl.lit(steps, pl.Int64),
            variant=pl.lit(name),
        )
        for (its_name, origin), table in zip(each, tables, strict=True)
        for run, seed, steps in [origin or (None, None, None)]
    ]
    labelled = label(pl.concat(parts), game, between)
    if isinstance(game, World) and not game.repeats:  # policies met other levels
        return labelled.with_columns(distinguishing=pl.lit(False))
    return mark_distinguishing(labelled, between)
