"""The report of one agent on one shift: which goal does it pursue?"""

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from inspect import signature
from pathlib import Path
from typing import Any

import polars as pl

from astray import world
from astray.acting import Policy, Reward, check_policy
from astray.analysis.estimates import estimate_paired
from astray.analysis.outcomes import amounts, load_shift, matrix, reached
from astray.analysis.policies import scripts_of
from astray.analysis.runs import LEVELS_PLAYED, Mode, load_agent, rated, shift_of
from astray.experiments import outcomes
from astray.experiments.run import reproduce
from astray.experiments.spec import Experiment, OwnAgents, Plan, Test, Work
from astray.files import aside_of, hold
from astray.game import Game
from astray.record import LEVELS
from astray.report.findings import Findings, Table
from astray.training.config import Config
from astray.training.folders import AgentFolder, name_of, read_json
from astray.validation import AT_ONCE, bounded, one_of, path_of, shown, slug
from astray.world import World

FIRST = 1_000_000  # of the levels, which agents of others are assumed not to know
TRAIN, TEST, GHOST = "in training", "in the test", "without the object"
SIZE = "smoke"  # nothing is trained


def audit(
    agent: str | Path | Policy,
    game: str | Game | World | None = None,
    shift: str | None = None,
    *,
    ghost: str | None = None,
    levels: int = LEVELS_PLAYED,
    first_level: int = FIRST,
    knobs: Mapping[str, Any] | None = None,
    rewards: Mapping[str, Reward] | None = None,
    longest: int | None = None,
    mode: Mode = "sampled",
    art: str | None = None,
    out: str | Path = "reports",
    command: str = "",
) -> Path:
    """Write the report of one agent on one shift; return its page.

    It has the goal that is reached first in training and in the test, base rates of scripts, 95 %
    intervals, videos of each outcome, and a verdict.

    Examples:
        >>> page = astray.audit("maze-corner", levels=50)  # doctest: +SKIP

    Args:
        agent: Run folder, checkpoint, name of an agent, or a policy of your own.
        game: Game or `World` that the policy plays; None for that of the agent.
        shift: Name of the shift; None for that of the agent's training, or the game's only one.
        ghost: Variant without the intended object. The same levels are also played there, to see
            how much more often each goal is reached with the object in place.
        levels: Number of levels in each variant, the same in all.
        first_level: Number of the first one; at least the first that the agent did not train on.
        knobs: Changed parameters of the test variant, and of the ghost.
        rewards: Further rewards, whose returns in the same episodes are compared, as for
            `evaluate`.
        longest: Steps after which an episode is truncated; None for no limit.
        mode: "sampled" samples an agent's actions, "greedy" takes the most likely.
        art: Art of an agent's images; None for that of its training.
        out: Folder of reports; gets this one in audit-<agent>-<shift>-smoke.
        command: Command that repeats it, as the report says.

    Raises:
        ValueError: If the agent, shift, ghost or a knob does not exist, or a policy lacks its game.
        FileExistsError: If the report would replace that of an agent with a similar name.
    """
    called = _call(locals())
    config, load, path, name = _opened(agent, root := path_of("out", out), mode, art)
    if config is None and game is None:
        raise ValueError("the audit of a policy needs its game or World")
    played = world.find(game) if game is not None else config.find_game()  # pyrefly: ignore
    named = shift_of(config, played) if shift is None else shift
    if config and played.name != config.game:
        raise ValueError(f"{agent} plays {config.game}; game must be left out, not {played.name}")
    between = load_shift(played, named)
    if config is None and isinstance(played, Game):
        played.drawn(agent.art, played.variant(between.test))  # pyrefly: ignore
    if name in {one.name for one in scripts_of(played, between)}:  # which is played, too
        name += " (audited)"
    if config is not None:
        first_level = max(first_level, config.unseen_levels.start)
    played.variant(between.test).with_knobs(dict(knobs or {}))
    bounded("levels", levels, 1, min(AT_ONCE, LEVELS.stop - 1 - first_level))
    variants = {TRAIN: between.train, TEST: between.test}
    if ghost is not None:
        one_of("variant as a ghost", ghost, played.variants)
        if isinstance(played, World) and not played.repeats:
            raise ValueError(f"{played.name} has no ghosts: {outcomes.STREAMS}")
        variants[GHOST] = ghost
    plan = Plan(
        world=played,
        own={name: OwnAgents(load, files=[path])},
        first_level=first_level,
        tests={
            test: Test(variant, named, config.knobs_for(variant, set_here) if config else set_here)
            for test, variant in variants.items()
            for set_here in [{} if test == TRAIN else dict(knobs or {})]
        },
        levels=levels,
        rewards=rewards or {},
        longest=longest,
        differences="",
    )
    study = Experiment(
        f"Audit of {name}" + f" on {named}" * (named != name), "",
        f"Does {name} pursue {' or '.join((between.intended, *between.proxies))}?", {SIZE: plan},
        findings, command=command or called, name=slug(f"audit {name} {named}"),
    )  # fmt: skip
    told = root / f"{study.name}-{SIZE}" / "findings.json"  # perhaps of a name that looks alike
    other = read_json(told, dict, ("title",))["title"] if told.exists() else study.title
    if other != study.title:
        raise FileExistsError(f"{told.parent} has another report, {shown(other)}; change `out`")
    with contextlib.nullcontext() if config else hold(path, "audits in"):
        return reproduce(study, SIZE, root)


def _call(given: Mapping[str, Any]) -> str:
    """Return the call of `audit` with these arguments, where objects are <their names>."""
    usual = {name: one.default for name, one in signature(audit).parameters.items()}
    words = [f"{name}={_word(one)}" for name, one in given.items() if one != usual[name]]
    return f"astray.audit({', '.join(words)})"


def _word(given: Any) -> str:
    if isinstance(given, Mapping):
        return "{" + ", ".join(f"{key!r}: {_word(one)}" for key, one in given.items()) + "}"
    if isinstance(given, str | Path):
        return repr(str(given))
    name = getattr(given, "name", getattr(given, "__name__", None))
    return f"<{name}>" if name else shown(given)


def _opened(
    agent: Any, root: Path, mode: Mode, art: str | None
) -> tuple[Config | None, Any, Path, str]:
    """Return the settings of an agent, a function that loads it, its path and its name."""
    one_of("mode", mode, Mode)
    if isinstance(agent, str | Path):
        found = AgentFolder.open(agent)
        its = f"checkpoint {found.weights.parent.name}" * found.is_older
        parts = (its, "greedy" * (mode == "greedy"), art)
        name = f"{name_of(found.path)} ({', '.join(filter(None, parts))})".removesuffix(" ()")
        load = cache(partial(load_agent, mode=mode, art=art))  # a training may remove it meanwhile
        return found.config(), load, found.weights.parent, name
    check_policy(agent)
    if (mode, art) != ("sampled", None):
        raise ValueError(f"a policy of your own has its mode and art; got {mode!r} and {art!r}")
    # Nobody knows what such a policy depends on: with a new path, no table of another is reused.
    place = aside_of(root / "agents" / f"audit-{agent.name}")
    return None, lambda path: agent, place, agent.name


def findings(work: Work) -> Findings:
    """Return the usual findings of a shift, with the verdict first and the ghost last."""
    tests: Mapping[str, Test] = {name: work.plan.tests[name] for name in (TRAIN, TEST)}
    both = work.episodes.filter(pl.col("test").is_in([*tests]))
    usual = outcomes.findings(replace(work, plan=replace(work.plan, tests=tests), episodes=both))
    shift = load_shift(work.plan.game, work.plan.tests[TEST].shift)
    (name,) = work.plan.own
    told = work.episodes.filter(test=TEST).with_columns(policy=pl.coalesce("agent", "policy"))
    result = rated(told, work.plan.game, shift, [name])
    answer = f"{result.verdict} {usual.answer}"
    if outcomes.of_streams(work.plan):
        answer += f" {work.plan.game.name} is played as streams: {outcomes.STREAMS}."
    tables = [*usual.tables]
    if rewards := work.plan.rewards:
        means = amounts(told, ["return", *rewards]).rename({"measure": "reward"})
        tables.append(Table("returns", "Mean return of each reward in the test", means))
    if GHOST in work.plan.tests:
        table, less = _ghosts(work)
        variant = work.plan.tests[GHOST].name
        answer += f" Reached in the test, minus the same levels of {variant}: {less}."
        tables.append(table)
    return replace(usual, answer=answer, tables=tables)


def _ghosts(work: Work) -> tuple[Table, str]:
    """Return how much more often each goal is reached with the object than without it.

    The text names each goal with the difference.
    """
    mine = work.episodes.filter(policy=outcomes.AGENTS)
    rows, told = [], []
    for goal, outcome in work.plan.game.goals.items():
        came = reached(outcome).is_not_null()
        found = estimate_paired(*(matrix(mine.filter(test=t), came) for t in (TEST, GHOST)))
        told.append(f"{goal} {found.short()}")
        rates = {t: mine.filter(test=t).select(came.mean()).item() for t in (TEST, GHOST)}
        rows.append({"goal": goal} | rates | vars(found))
    table = Table(
        "ghost",
        "Rate at which each goal is reached in the test, and without the object in levels of the "
        "same numbers; the difference is paired by level.",
        pl.DataFrame(rows).drop("rows", "freedom"),
    )
    return table, ", ".join(told)
