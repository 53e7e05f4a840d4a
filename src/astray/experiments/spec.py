"""Specification of an experiment: trainings and tests as data, and functions for its findings."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import polars as pl

from astray import games, imports, provenance, world
from astray.acting import Policy, Reward
from astray.analysis.estimates import detectable
from astray.analysis.evaluate import Measure, check_measures
from astray.analysis.outcomes import load_shift, name_of
from astray.analysis.policies import scripts_of
from astray.analysis.tables import read_table, write_table
from astray.envs.compiled import functions_of
from astray.envs.worlds import shown_first
from astray.files import check_own
from astray.game import OWN, Game, Variant
from astray.outcome import COLUMNS
from astray.record import LEVELS
from astray.report.findings import Findings
from astray.report.page import COMPUTED
from astray.training.config import MACHINE, PRESETS, SOLVER, Config, Device, Named
from astray.training.folders import START, TEACHER
from astray.training.settings import SEEDS, make_plain
from astray.validation import MOST, bounded, of_kind, shown
from astray.world import World, WorldVariant

if TYPE_CHECKING:
    from astray.analysis.trained import Agent, Loaded

Size = Literal["smoke", "pixels", "night", "hour", "paper", "published"]
SIZES: tuple[Size, ...] = get_args(Size)
SPREADS = 0.03, 0.15  # standard deviations between agents: all learn alike, and they do not
MOST_DISTANT = 0.5  # of rates from a bound: one in the middle has none further away
MOST_AGENTS = 10_000  # of one name, and of a sweep
OWN_LEVELS = 1_000_000  # the first level of tests of `own` agents, which they should not know
FEEDING = 4  # threads of the environments of a training on a GPU, which waits for them
PUBLISHED: Size = "published"  # of agents that others trained: nothing is trained
Place = Literal["here", "ray"]  # where agents are trained
Runs = Mapping[str, Sequence[Path]]  # the run folders of the agents of each name
NAMING = {"published": str, "teachers": str | Config, "starts": str}  # parts of plans, by names
NAMING |= {"measures": Callable, "rewards": Callable}


@dataclass(frozen=True)
class Test:
    """Levels to play agents on, and the shift that defines misgeneralization there."""

    variant: Named
    shift: Named  # which goal is intended, which are proxies
    knobs: Mapping[str, Any] = field(default_factory=dict)  # of the variant, changed

    def __post_init__(self) -> None:
        if isinstance(self.variant, WorldVariant):  # its factory is in no file
            object.__setattr__(self, "knobs", {**self.variant.knobs, **self.knobs})
            object.__setattr__(self, "variant", self.variant.name)
        make_plain(self, "knobs")

    @property
    def name(self) -> str:
        """Name of the variant in tables."""
        return name_of(self.variant)

    def variant_for(self, config: Config) -> Variant:
        """Return the variant for agents of that training, with its changed knobs."""
        return config.variant_for(self.variant, self.knobs)


def tests_of(game: str | World, shift: str) -> dict[str, Test]:
    """Return the training and the test variant of a shift as tests."""
    there = load_shift(game, shift)
    return {"in training": Test(there.train, shift), "in the test": Test(there.test, shift)}


@dataclass(frozen=True)
class OwnAgents:
    """Agents of one kind that astray does not train.

    Attributes:
        load: Function path -> policy.
        files: Files or folders of agents that exist, one for each seed.
        train: Function (seed, folder) that trains an agent and writes it to that empty folder, in
            the place of `files`.
    """

    load: Callable[[Path], Policy]
    files: Sequence[str | Path] = ()
    train: Callable[[int, Path], object] | None = None


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One size of an experiment, with everything to compute for it."""

    agents: Mapping[str, Config] = field(default_factory=dict)  # by name; all but the seed
    published: Mapping[str, str] = field(default_factory=dict)  # of those not trained here: the
    # agent that comes with astray, or of the catalogue of published ones, for each name
    # Of students, by name: which agents of the plan they are distilled from, each from that of its
    # own seed, or the settings of agents that are trained to teach alone.
    teachers: Mapping[str, str | Config] = field(default_factory=dict)
    # By name: which agents of the plan its trainings begin with, each with that of its own seed.
    starts: Mapping[str, str] = field(default_factory=dict)
    world: World | Game | None = None  # that `own` agents play; then there are no others
    own: Mapping[str, OwnAgents] = field(default_factory=dict)  # by name
    first_level: int | None = None  # of all tests; None: those that no agent has met, or for `own`
    # agents those from `OWN_LEVELS` on
    seeds: int = 1  # agents of each name
    first_seed: int = 0  # after that in the settings
    tests: Mapping[str, Test] = field(default_factory=dict)  # by name; all agents are played in all
    visited: Mapping[str, Test] = field(default_factory=dict)  # by name; what the experiment itself
    # looks at states of
    levels: int  # of each test, none met in any training under any number
    differences: str  # from the paper, in words; empty where there is none
    measures: Mapping[str, Measure] = field(default_factory=dict)  # of an episode's last state
    rewards: Mapping[str, Reward] = field(default_factory=dict)  # further ones, of all episodes
    longest: int | None = None  # steps after which an episode is truncated; None for no limit
    device: Device | None = None  # of all trainings; None: as their settings say
    speed: int = 0  # environment steps that a core trains with in a second, as measured; 0: unknown

    def __post_init__(self) -> None:
        make_plain(self, "first_level", "seeds", "first_seed", "levels", "longest", "speed")
        provenance.see(self.measures, self.rewards, self.world, self.own)
        kinds = {"agents": Config, "own": OwnAgents, "tests": Test, "visited": Test} | NAMING
        for part, kind in kinds.items():
            of_kind(part, given := getattr(self, part), Mapping)
            for name, one in given.items():
                of_kind(f"{shown(name)} of {part}", one, kind)
        bounded("first_seed", self.first_seed, 0, SEEDS - 1)
        first = self.first_seed + max((one.seed for one in self.agents.values()), default=0)
        bounded("seeds", self.seeds, 1, min(MOST_AGENTS, SEEDS - first))
        bounded("speed", self.speed, 0, MOST)
        if not set(self.published) <= set(self.agents):
            raise ValueError("`published` must name agents of the plan")
        students = set(self.teachers)
        named = {name for name in self.teachers.values() if isinstance(name, str)}
        if not students | named <= set(self.agents):
            raise ValueError("`teachers` must name agents of the plan")
        if students & {*self.published, *named}:
            raise ValueError("a student must be trained here, and teach nobody")
        for name, teacher in self.teachers.items():
            its = teacher if isinstance(teacher, Config) else self.agents[teacher]
            if its.observation == "image" and (art := self.agents[name].art) != its.art:
                raise ValueError(f"{self.called(name)} sees art {its.art!r}; {name} has {art!r}")
        if not {*self.starts, *self.starts.values()} <= self.agents.keys() - set(self.published):
            raise ValueError("`starts` must name agents of the plan that are trained here")
        for name, first in self.starts.items():
            for what in ("network", "observation", "scale", "width"):
                mine, its = (getattr(self.agents[x], what) for x in (name, first))
                if mine != its:
                    raise ValueError(f"{name} begins with {first}, of {what} {its}; got {mine}")
        self.phases()
        for name, config in {**self.agents, **self._only_teach}.items():
            is_named = name in students or name in self.published
            if not is_named and (teacher := config.teacher) not in (None, SOLVER):
                raise ValueError(f"{name} is a student of {teacher}: name it in `teachers`")
        fewest = min([MOST, *(len(config.unseen_levels) for config in self.agents.values())])
        bounded("levels", self.levels, 1, fewest)
        if self.device and (self.published or self.own):
            raise ValueError(f"device is for agents that are trained here; got {self.device!r}")
        if self.own and self.first_level is None:
            object.__setattr__(self, "first_level", OWN_LEVELS)
        if self.first_level is not None:
            bounded("first_level", self.first_level, LEVELS.start, LEVELS.stop - self.levels)
        self._check_own()
        games = {config.game for config in self.agents.values()}
        if (self.tests or self.visited) and self.world is None and len(games) != 1:
            raise ValueError("what is played in the same tests are agents, and of one game")
        if self.agents or self.world is not None:
            there = (*COLUMNS, *self.game.events, *self.game.measures)
            check_measures(self.measures, there)
            check_measures(self.rewards, (*there, *self.measures), "rewards")
        for test in (*self.tests.values(), *self.visited.values()):
            scripts = [one.name for one in scripts_of(self.game, load_shift(self.game, test.shift))]
            if {*scripts} & {*self.agents, *self.own}:  # their episodes would be counted together
                raise ValueError(f"agents need other names than the scripts {', '.join(scripts)}")
            for config in self.agents.values():
                test.variant_for(config)
            self.variant_of(test)

    def _check_own(self) -> None:
        """Raise ValueError unless agents of others are alone and one per seed."""
        if (self.world is None) == bool(self.own) or (self.own and self.agents):
            raise ValueError("a plan has either agents, or own agents and the world they play")
        whose: dict[str, str] = {}  # files
        for name, given in self.own.items():
            if (given.train is None) != (len(given.files) == self.seeds):
                raise ValueError(
                    f"own agents {name!r} need `train`, or `files`: one for each of {self.seeds} "
                    f"seeds; got {len(given.files)} files"
                )
            for file in given.files:
                if (first := whose.setdefault(str(file), name)) != name:
                    told = "files tell agents apart, so give one of them a copy"
                    raise ValueError(f"{file} is of own agents {first!r} and {name!r}; {told}")

    def variant_of(self, test: Test) -> Any:
        """Return the variant of a test as the first agents play it."""
        if self.world is not None:
            return self.game.variant(test.variant).with_knobs(dict(test.knobs))  # pyrefly: ignore
        return test.variant_for(self.config)

    def power(self) -> list[float]:
        """Return the detectable distances of rates and differences, with 80 % power.

        The distance of a rate is that from its bound. There is one value for each of `SPREADS`,
        before corrections for the number of claims; infinity from `MOST_DISTANT` on. With one agent
        only levels vary. With a single kind of agents the difference is NaN.
        """
        alone, kinds = self.seeds == 1 or self.published, len(self.agents) + len(self.own)
        agents, spreads = (1, (0.0, 0.0)) if alone else (self.seeds, SPREADS)
        rates = [detectable(agents, self.levels, spread) for spread in spreads]
        more = [detectable(agents, self.levels, s, kinds=kinds) for s in spreads if kinds > 1]
        return [math.inf if x >= MOST_DISTANT else x for x in rates + (more or [math.nan] * 2)]

    @property
    def config(self) -> Config:
        """The settings of the first agents."""
        return next(iter(self.agents.values()))

    @property
    def game(self) -> Game:
        """The game or `World` to play; a `World` is typed as a game."""
        return world.find(self.world) if self.world is not None else self.config.find_game()

    def drawn_with(self, art: str) -> Plan:
        """Return the plan with other art; raise ValueError if no agents that it trains see it."""
        if self.published or not self.agents:
            if art != OWN:
                raise ValueError(f"published agents see the art that they know; got {shown(art)}")
            return self
        for config in self.agents.values():
            config.find_game().drawn(art, config.training_variant())  # told before the work
        agents = {name: replace(config, art=art) for name, config in self.agents.items()}
        teachers = {
            name: replace(one, art=art)  # which they are shown, as their students are
            if isinstance(one, Config) and one.observation == "image"
            else one
            for name, one in self.teachers.items()
        }
        return replace(self, agents=agents, teachers=teachers)

    def trainings(self) -> dict[str, list[Config]]:
        """Return the settings of all agents that are trained here, also to teach alone."""
        threads = 1 if self.device == "cpu" else FEEDING
        how: dict[str, Any] = {"device": self.device, "threads": threads} if self.device else {}
        return {
            name: [replace(self._begun(name, config, k), **how) for k in range(self.seeds)]
            for name, config in {**self.agents, **self._only_teach}.items()
            if name not in self.published
        }

    @property
    def _only_teach(self) -> dict[str, Config]:
        """The settings of agents that are trained to teach alone, by name."""
        pairs = self.teachers.items()
        return {self.called(name): one for name, one in pairs if isinstance(one, Config)}

    def _begun(self, name: str, config: Config, number: int) -> Config:
        """Return the settings of a name's training, by number, with its seed, teacher and start."""
        first = self.starts.get(name)
        if first is not None:
            begun = name_of_run(self._begun(first, self.agents[first], number))
            config = replace(config, start=begun)
        if name in self.teachers:
            config = replace(config, teacher=self._teacher_of(name, number))
        return replace(config, seed=config.seed + self.first_seed + number)

    def sources(self, name: str) -> dict[str, str]:
        """Return the agents whose weights a name's trainings need, by the file of the weights."""
        found = {TEACHER: self.called(name)} if name in self.teachers else {}
        return found | ({START: self.starts[name]} if name in self.starts else {})

    def phases(self) -> list[list[str]]:
        """Return the names of all trainings in groups, each after those whose weights it needs.

        Raises:
            ValueError: If trainings begin with each other's agents.
        """
        names = dict.fromkeys([*self.agents, *map(self.called, self.teachers)])
        waiting = [name for name in names if name not in self.published]
        found: list[list[str]] = []
        while waiting:
            ready = [n for n in waiting if not {*self.sources(n).values()} & {*waiting}]
            if not ready:
                raise ValueError(f"agents begin with each other's weights: {', '.join(waiting)}")
            found.append(ready)
            waiting = [name for name in waiting if name not in ready]
        return found

    def called(self, student: str) -> str:
        """Return the name of a student's teachers."""
        teacher = self.teachers[student]
        return teacher if isinstance(teacher, str) else f"teacher of {student}"

    def _teacher_of(self, student: str, number: int) -> str:
        """Return the name of a student's teacher: that of a published agent, or of a training."""
        teacher = self.teachers[student]
        if isinstance(teacher, Config):
            return name_of_run(self._begun(self.called(student), teacher, number))
        if teacher in self.published:
            return self.published[teacher]
        return name_of_run(self._begun(teacher, self.agents[teacher], number))


def open_agents(plan: Plan, runs: Runs) -> dict[str, list[Agent | Loaded]]:
    """Open the agents of each name."""
    from astray.analysis.runs import open_run  # here, as torch takes two seconds to import
    from astray.analysis.trained import Loaded

    return {
        name: [
            Loaded(plan.own[name].load(run), run, seed) if name in plan.own else open_run(run)[0]
            for seed, run in enumerate(made, plan.first_seed)
        ]
        for name, made in runs.items()
    }


def own_sources(config: Config) -> dict[str, str] | None:
    """Return the digest of each module of a training that is not astray's.

    It is None for astray's own games and networks, whose agents outlive its versions.
    """
    try:
        code = config.code()
    except ValueError:  # it cannot be imported, which is told before any training
        return None
    if len(code) == 1 and config.game in games.OWN:
        return None
    found = provenance.sources(code) or {}  # a notebook has none
    return {name: one for name, one in found.items() if not f"{name}.".startswith("astray.")}


def own_code(config: Config) -> str:
    """Return a text of a training's own sources and values, if any, and of what its World shows."""
    if (mine := own_sources(config)) is None:
        return ""
    game, variant = config.find_game(), config.training_variant()
    is_world = isinstance(game, World)
    shown = shown_first(game, variant, config.first_level) if is_world else ""  # pyrefly: ignore
    rules = () if is_world else functions_of(game, config.art).values()  # pyrefly: ignore
    kept = [game] * is_world, [*config.custom().values()], [*filter(provenance.is_users, rules)]
    return f"{sorted(mine.items())}{shown}{[*provenance.values(kept)] or ''}"


def check_unedited(config: Config, known: Mapping[str, str]) -> None:
    """Raise ValueError if a training's modules are not those that a command began with.

    Args:
        known: Digests of modules, as `own_sources` found them then.
    """
    for name, digest in (own_sources(config) or {}).items():
        # A script's objects are sent to a process as they are.
        if name not in ("__main__", "__mp_main__") and known.get(name, digest) != digest:
            raise ValueError(
                f"{name} was edited after this command began, and its agents must be of one code; "
                "undo the edit, and the same command goes on, or it trains anew with the edit"
            )


def name_of_run(config: Config) -> str:
    """Return the name of a training with these settings and code, equal in all experiments."""
    usual = PRESETS["paper"].flat()  # left out, so that a new setting changes no name
    apart = {"seed", *MACHINE}
    settings = {k: v for k, v in config.flat().items() if k not in apart and v != usual[k]}
    told = json.dumps(settings, sort_keys=True) + own_code(config)
    digest = hashlib.sha256(told.encode()).hexdigest()[:8]
    return f"{config.game}-{config.variant}-{digest}/seed-{config.seed}"


def plan_of(
    agent: str, config: Config, game: str, shift: str, *, levels: int = 1000, **more: Any
) -> Plan:
    """Return the plan of one kind of agent, trained and tested on the variants of a shift.

    Args:
        config: Settings of the agents; game, variant and validation are those of the shift.
        more: Further parts of the `Plan`.
    """
    between = load_shift(game, shift)
    trained = replace(config, game=game, variant=between.train, validation=between.test)
    return Plan(agents={agent: trained}, tests=tests_of(game, shift), levels=levels, **more)


@dataclass(frozen=True)
class Work:
    """Results of an experiment of one size, for its findings."""

    name: str
    size: Size
    plan: Plan
    folder: Path  # of the report
    digest: str  # of all that its tables are computed of: see `run.note`
    runs: Runs
    episodes: pl.DataFrame  # of all agents and scripted policies in all tests; see `run.play`

    def keep(self, name: str, compute: Callable[[], pl.DataFrame]) -> pl.DataFrame:
        """Return a table from its file, or from `compute` the first time."""
        return cached(self.folder, f"{name}-{self.digest}", compute)


def computed(folder: Path) -> Path:
    """Return the folder of a report's tables; raise OSError if it is a link to what may be any."""
    if (place := folder / COMPUTED).is_symlink():
        raise OSError(f"{place} must be a folder of its own; it is a link")
    return place


def cached(folder: Path, name: str, compute: Callable[[], pl.DataFrame]) -> pl.DataFrame:
    """Return the table `name` of a report's folder; `compute` and store it if it is missing.

    Raises:
        ValueError: If the file is not a table of astray's.
    """
    path = computed(folder) / f"{name}.parquet"
    check_own(path)  # before it is computed
    if path.exists():
        try:
            return read_table(path, signed=True)
        except ValueError as error:
            raise ValueError(f"{error}; remove it, and it is computed again") from error
    table = compute()
    write_table(table, path)
    return table


@dataclass(frozen=True)
class Experiment:
    """A figure or table of the paper, or of our own."""

    title: str
    reproduces: str
    question: str
    sizes: Mapping[Size, Plan]
    find: Callable[[Work], Findings]
    needs: Mapping[str, str] = field(default_factory=dict)  # of `find`: package -> extra of astray
    command: str = ""  # that repeats it; empty for `astray reproduce`
    name: str = ""  # of its report; empty for that of its file or title

    def __post_init__(self) -> None:
        parts = isinstance(self.sizes, Mapping) and self.sizes.values()
        if not parts or {*self.sizes} - {*SIZES} or not all(isinstance(x, Plan) for x in parts):
            raise ValueError(f"sizes must be plans for {', '.join(SIZES)}; got {shown(self.sizes)}")
        of_kind("find", self.find, Callable)
        provenance.see(self.find)

    def check_installed(self) -> None:
        """Raise ImportError if a package for the findings is missing."""
        for package, extra in self.needs.items():
            if importlib.util.find_spec(package) is None:
                raise imports.missing(f"{self.title!r} needs {package}", extra)
