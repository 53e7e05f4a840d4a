"""Runs of experiments: plan, compute what is missing, and write the report."""

import contextlib
import hashlib
import json
import os
import re
import sys
import uuid
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import polars as pl
import torch

from astray import games, imports, provenance
from astray.analysis.outcomes import load_shift
from astray.envs.compiled import loop_of
from astray.envs.worlds import shown_first
from astray.experiments import catalogue, labs, outcomes
from astray.experiments.levels import check_tests, play, try_tests
from astray.experiments.spec import (
    PUBLISHED,
    Experiment,
    Place,
    Plan,
    Runs,
    Size,
    Work,
    computed,
    name_of_run,
    own_sources,
)
from astray.experiments.track import track_report
from astray.experiments.workers import expected, train_all
from astray.files import check_free, check_writable, folder_aside, hold, read, write_aside
from astray.game import OWN
from astray.report import page as report
from astray.report.claims import corrected
from astray.report.findings import Findings
from astray.training import checkpoint, folders
from astray.training.config import SOLVER, Config, Device, Fast, Tracking
from astray.training.folders import AgentFolder, read_config
from astray.training.loop import begin, checked, improve
from astray.training.teacher import give
from astray.training.track import check_installed
from astray.validation import MOST, bounded, brief, of_kind, one_of, path_of
from astray.world import World

ALL = "all"  # experiments of a size
PLAN = "plan.json"  # in a report's folder, which is known by it
TABLE = re.compile(r".+-([0-9a-f]{16})\.parquet")  # the names of tables, which nobody else gives


def reproduce(
    experiment: str | Experiment,
    size: Size,
    root: str | Path,
    *,
    workers: int | None = None,
    on: Place = "here",
    device: Device | None = None,
    art: str = OWN,
    track: Tracking | None = None,
) -> Path:
    """Train what is missing of an experiment, evaluate it, and return the path of the report.

    Examples:
        >>> report = astray.reproduce("maze-corner", "smoke", Path("reports"))  # doctest: +SKIP

    Args:
        experiment: Name in the catalogue, or an `Experiment`: see `catalogue.find`.
        root: Folder of reports, the command's `--out`: this one is written to <name>-<size>, and
            `agents` is shared by all. On a cluster all nodes must see it.
        workers: Number of agents trained at once here; None for one per processor.
        on: Place of the trainings; evaluation happens here.
        device: Device of the trainings, which may go on on another; None for that of their
            settings, a CPU in all sizes but hour and paper.
        art: Art of all images; with original art the report's folder is <name>-<size>-<art>.
        track: External tracker of trainings and report: wandb or trackio.

    Raises:
        ValueError: If there is no such experiment, size or art.
        OSError: If the report's folder holds files that astray did not write.
    """
    name, whole = sized(experiment, size)
    plan, ending = whole.sizes[size].drawn_with(art), "" if art == OWN else f"-{art}"
    plan = replace(plan, device=device)
    folder = (root := path_of("root", root)) / f"{name}-{size}{ending}"
    whole.check_installed()
    if whole.find is outcomes.findings and len(plan.tests) < 2:
        told = "in training and in the test, as spec.tests_of gives them; got"
        raise ValueError(f"the usual findings are of two tests, {told} {[*plan.tests]}")
    if track:
        check_installed(track)
    check_free(folder, PLAN, b'"sources"', report.WRITTEN, (report.COMPUTED, "videos"))
    given = experiment if isinstance(experiment, str) else name
    heading = report.Heading(
        name=name,
        size=size,
        title=whole.title,
        reproduces=whole.reproduces,
        question=whole.question,
        differences=plan.differences,
        command=whole.command
        or f"astray reproduce {given} --size {size}" + (f" --art {art}" if ending else ""),
    )
    # Results of agents of others stand beside those of agents trained here.
    beside = report.of_claims(root / f"{name}-smoke") if size == PUBLISHED else {}
    with hold(folder, "works on"), threads_for(size):
        check_study(folder, origin := catalogue.origin(experiment, folder))
        runs = train_agents(plan, root, workers, on, track)
        check_writable(folder / PLAN)  # before the agents are played
        text, digest = inputs(plan, runs, whole)
        work = Work(name, size, plan, folder, digest, runs, pl.DataFrame())
        if plan.tests:
            work = replace(work, episodes=work.keep("episodes", lambda: play(plan, runs)))
        note(text, digest, folder, origin)
        findings = whole.find(work)
        of_kind("what `find` of an experiment returns", findings, Findings)
        findings = replace(findings, claims=corrected(findings.claims))
        videos = [video.scene for video in findings.videos if video.scene]
        page = report.write(heading, findings, folder, beside, labs.write(videos, folder))
        if track:
            track_report(heading, findings, folder, track)
        return page


def sized(experiment: str | Experiment, size: Size) -> tuple[str, Experiment]:
    """Return `catalogue.find`'s name and experiment; raise ValueError if the size is missing."""
    name, whole = catalogue.find(experiment)
    one_of("size", size, whole.sizes, of=name)
    with contextlib.suppress(ValueError):  # the training says what cannot be imported
        code_of(whole.sizes[size], whole)  # while its files are still what was imported
    return name, whole


@contextlib.contextmanager
def threads_for(size: Size) -> Iterator[None]:
    """Use one torch thread for small networks, which are slower with more."""
    before = torch.get_num_threads()
    if size != PUBLISHED:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def train_agents(
    plan: Plan, root: Path, workers: int | None, on: Place, track: Tracking | None = None
) -> Runs:
    """Train the missing agents of a plan; return all run folders.

    Published agents must be present, or it raises ValueError: nothing is downloaded unasked.
    """
    if workers is not None:
        bounded("workers", workers, 1, MOST)
        if on == "ray":
            raise ValueError("a cluster says how many agents are trained at once; leave `workers`")
    for agent in {*plan.published.values()} - {*folders.names()}:
        raise ValueError(
            f"the published agent {agent} is not here; to bring it: astray agents fetch {agent}, "
            f"and the pictures that it sees: astray art import"
        )
    runs = {name: [folders.find(agent)] for name, agent in plan.published.items()}
    trainings = plan.trainings()
    runs |= {name: [run_folder(root, one) for one in its] for name, its in trainings.items()}
    runs |= {name: own_runs(plan, name, root) for name in plan.own}
    todo = {run: one for n, its in trainings.items() for run, one in zip(runs[n], its, strict=True)}
    known = {name: one for c in todo.values() for name, one in (own_sources(c) or {}).items()}
    missing = {run: one for run, one in todo.items() if not checkpoint.finished(run, one)}
    if missing:
        checkpoint.check_all(missing)
        if on == "here":  # else some of these wait for their turn
            check_trainable(plan, trainings)
    if plan.own or missing:
        check_tests(plan)  # before hours of training, not after
        try_tests(plan)
    for name in sorted(plan.own, key=lambda name: plan.own[name].train is not None):
        make_own(plan, name, runs[name])  # files may be missing: first
    if missing and plan.speed and on == "here" and plan.device in (None, "cpu"):
        tested = {run for name in plan.agents for run in runs[name]}  # others are soon trained
        slow = {run: one for run, one in todo.items() if run in tested}
        print(expected(slow, plan.speed, workers), file=sys.stderr, flush=True)
    for names in plan.phases():
        give_weights(plan, runs, names)
        now = {run for name in names for run in runs[name]}
        its = {run: one for run, one in todo.items() if run in now}
        train_all(its, workers, on, track, known)
    return {name: its for name, its in runs.items() if name in {*plan.agents, *plan.own}}


def own_runs(plan: Plan, name: str, root: Path) -> list[Path]:
    """Return the files or folders of agents of others, which may be missing."""
    given = plan.own[name]
    if given.train is None:
        return [Path(file) for file in given.files]
    settings = [*provenance.values(given.train)]
    if isinstance(plan.world, World):
        trained_in, variant = {s.train for s in plan.world.shifts.values()}, plan.world.variant
        level = plan.first_level or 0
        settings += [shown_first(plan.world, variant(one), level) for one in sorted(trained_in)]
    digest = provenance.digest(given.train, plan.world, data=settings) or uuid.uuid4().hex
    home = root / "agents" / f"{plan.game.name}-{name}-{digest[:8]}"
    return [home / f"seed-{plan.first_seed + k}" for k in range(plan.seeds)]


def make_own(plan: Plan, name: str, runs: Sequence[Path]) -> None:
    """Train the agents of others that are missing of `runs`, as `own_runs` has them.

    Raises:
        FileNotFoundError: If a file does not exist.
        ValueError: If a training function wrote nothing.
    """
    train = plan.own[name].train
    for seed, run in enumerate(runs, plan.first_seed):
        if run.exists():
            continue
        if train is None:
            raise FileNotFoundError(f"there is no agent {name!r} at {run}")
        with hold(run.parent, "trains in"), folder_aside(run) as aside:
            if run.exists():  # another study had it trained meanwhile
                continue
            train(seed, aside)
            if not any(aside.iterdir()):
                raise ValueError(f"the training of {name!r}, seed {seed}, wrote no file")
            os.replace(aside, run)


def check_trainable(plan: Plan, trainings: Mapping[str, Iterable[Config]]) -> None:
    """Raise ValueError if one of a plan's trainings, by agents' names, could not begin here."""
    for name, (config, *_) in trainings.items():
        try:
            config = checked(config)
            if config.teacher not in (None, SOLVER):  # whose weights are not here yet
                config = replace(config, teacher=None, taught=1.0)
            if name in plan.starts:  # nor are these
                config = replace(config, start=None)
            if config.device != "cpu":  # whose memory is for the trainings
                config = replace(config, device="cpu", fast=Fast())
            is_own = bool(config.custom())  # which may fail; tried with one minibatch of the size
            if is_own and config.num_steps % config.minibatches == 0:
                steps = config.num_steps // config.minibatches
                config = config.changed(num_steps=steps, minibatches=1, epochs=1)
            # The training warns.
            with warnings.catch_warnings(action="ignore"), contextlib.closing(begin(config)) as one:
                if is_own:
                    improve(one)
        except (ValueError, FileNotFoundError) as error:
            raise ValueError(f"{name} cannot be trained: {error}") from error


def give_weights(plan: Plan, runs: Runs, names: Iterable[str]) -> None:
    """Write to the run folders of `names` the weights of trained agents that they need."""
    for name in names:
        for file, source in plan.sources(name).items():
            its = runs[source]
            for number, run in enumerate(runs[name]):
                one = AgentFolder.open(its[number % len(its)])  # a published one is for all
                give(one.weights, run, file)


def reproduce_each(names: Sequence[str], size: Size, root: Path, **how: Any) -> Path:
    """Run experiments one after the other, also after failures; return the index page.

    Args:
        names: As for `reproduce`, or "all" for all in the catalogue with this size.
        how: Further arguments of `reproduce`.

    Raises:
        ValueError: If an experiment or its size does not exist, or none has such art; before any
            work.
        OSError: If the folder has an `index.html` that astray did not write; before any work.
        RuntimeError: If some failed; at the end.
    """
    check_free(path_of("root", root), report.INDEX, report.INDEX_SIGN, ())
    chosen: list[str] = []
    for name in names:
        there = catalogue.NAMES if name == ALL else ()
        chosen += [n for n in there if size in catalogue.load(n).sizes] or [name]
    chosen = [*dict.fromkeys(chosen)]
    found = [sized(name, size) for name in chosen]
    called = [name for name, _ in found]
    if twice := {name for name in called if called.count(name) > 1}:
        raise ValueError(f"two of these would share the report {min(twice)!r}; rename a file")
    plans, undrawn = [whole.sizes[size] for _, whole in found], []
    for plan in plans:
        try:
            plan.drawn_with(how.get("art", OWN))
        except (ValueError, FileNotFoundError) as error:
            undrawn.append(error)
    if len(undrawn) == len(plans):
        raise undrawn[0]
    failed: dict[str, str] = {}
    for name in chosen:
        try:
            reproduce(name, size, root, **how)
        except Exception as error:
            failed[name] = told = f"{brief(error)}{imports.place(error)}"
            print(f"{name} failed, and the next goes on: {told}", file=sys.stderr, flush=True)
        else:
            report.write_index(root)
    if failed:
        told = "; ".join(f"{name}: {why}" for name, why in failed.items())
        raise RuntimeError(f"{len(failed)} of {len(chosen)} experiments failed: {told}")
    return report.write_index(root)


def run_folder(root: Path, config: Config) -> Path:
    """Return the run folder for these settings and code, which experiments share."""
    return root / "agents" / name_of_run(config)


def check_study(folder: Path, origin: str | None) -> None:
    """Raise ValueError if the report in `folder` is of another study, which is still there.

    Args:
        origin: Result of `catalogue.origin`.
    """
    there = None
    with contextlib.suppress(FileNotFoundError, ValueError, AttributeError, RecursionError):
        there = json.loads(read(folder / PLAN)).get("study")
    is_other = isinstance(there, str) and origin and there != origin
    if is_other and (there in catalogue.NAMES or os.path.exists(folder / there)):
        old, new = (x if x in catalogue.NAMES else (folder / x).resolve() for x in (there, origin))
        told = f"{folder} has the report of {old}, which {new} would share"
        raise ValueError(f"{told}; rename a file, or give another folder")


def note(text: bytes, digest: str, folder: Path, origin: str | None = None) -> None:
    """Record a report's inputs and study in `folder`, and delete tables of other digests."""
    for table in computed(folder).glob("*.parquet"):
        found = TABLE.fullmatch(table.name)
        if found and found[1] != digest and table.is_file() and not table.is_symlink():
            table.unlink()
    noted = {"study": origin} | json.loads(text)
    write_aside(folder / PLAN, json.dumps(noted, indent=1).encode())


def studied(whole: Experiment | None) -> tuple[object, ...]:
    """Return the code that computes an experiment's tables beyond the episodes."""
    loaded = [sys.modules[name] for name in catalogue.MODULES.values() if name in sys.modules]
    study = [module for module in loaded if module.EXPERIMENT is whole]
    return (whole.find, study) if whole else ()


def code_of(plan: Plan, whole: Experiment | None = None) -> str | None:
    """Return a digest of the sources that a plan's tables are computed by.

    It is None if a source cannot be read, as in a notebook.
    """
    its = play, plan.measures, plan.rewards, *studied(whole), plan.world, plan.own
    return provenance.digest(*its, [config.code() for config in plan.agents.values()])


def inputs(plan: Plan, runs: Runs, whole: Experiment | None = None) -> tuple[bytes, str]:
    """Return JSON of everything that a plan's tables are computed from, and its digest.

    Tables have it in their names, so none is reused for other inputs. ValueError is raised if two
    agents of a kind have the same weights, as after a copy.

    Args:
        whole: Experiment that computes further tables than the episodes.
    """
    agents = {n: [agent_digest(run, n in plan.own) for run in made] for n, made in runs.items()}
    for name, made in agents.items():
        if len({*made}) < len(made):  # intervals would be too narrow
            told = f"two of {', '.join(map(str, runs[name]))} are one agent; remove one"
            raise ValueError(f"{told}, or let its training use a seed of its own")
    theirs = [c.find_game() for c in plan.agents.values() if c.game not in games.OWN]
    played = [plan.world, theirs, *(one.load for one in plan.own.values())]
    data = {
        "configs": {n: [c.identity() for c in made] for n, made in plan.trainings().items()},
        "published": [read_config(runs[n][0]).identity() for n in runs if n in plan.published],
        "agents": agents,
        "own": {name: [run.name for run in runs[name]] for name in plan.own},
        "tests": {name: asdict(test) for name, test in plan.tests.items()},
        "visited": {name: asdict(test) for name, test in plan.visited.items()},
        "levels": [plan.first_level, plan.levels, plan.longest],
        "measures": [*plan.measures, *plan.rewards],
        "values": [*provenance.values([*studied(whole)[:1], plan.measures, plan.rewards, *played])],
        "pretrained": [agent_digest(folders.find(name)) for name in folders.pretrained()],
        "resolved": resolved(plan),
        "sources": code_of(plan, whole) or uuid.uuid4().hex,
    }
    text = json.dumps(data, indent=1).encode()
    return text, hashlib.sha256(text).hexdigest()[:16]


def resolved(plan: Plan) -> dict[str, Any]:
    """Return what each test is for each of the plan's agents: levels, goals, pictures, rules."""
    shown: dict[str, str] = {}  # by variant, as all agents of a test are shown the same

    def rules(game: Any, variant: Any, art: str = OWN) -> str:
        """Return a digest of a game's kernels and values they keep, or of what a World shows."""
        if not isinstance(game, World):
            return loop_of(game, game.drawn(art).name).__qualname__
        if (key := str(variant)) not in shown:
            shown[key] = shown_first(game, variant, plan.first_level or 0)
        return shown[key]

    own = {
        name: [
            str(plan.variant_of(test)),
            asdict(load_shift(plan.game, test.shift)),
            rules(plan.game, plan.variant_of(test)),
        ]
        for name, test in {**plan.tests, **plan.visited}.items()
        if plan.own
    }
    return own | {
        f"{name} of {agent}": [
            test.variant_for(config).to_json(),
            asdict(load_shift(config.find_game(), test.shift)),
            pictures_of(config, test.variant_for(config)),
            rules(config.find_game(), test.variant_for(config), config.art),
        ]
        for name, test in {**plan.tests, **plan.visited}.items()
        for agent, config in plan.agents.items()
    }


def pictures_of(config: Config, variant: Any) -> str:
    """Return a digest of the pictures that agents are shown; originals are checked when read."""
    is_shown = config.observation == "image" and not config.art.startswith("original")
    looks = config.find_game().drawn(config.art) if is_shown else None  # a World renders its own
    parts = looks.pictures(variant, 64) if looks else ()
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:16]


def agent_digest(run: Path, is_own: bool = False) -> str:
    """Return a digest of the last agent in a run folder; of others, of their file or all files."""
    if not is_own:
        return AgentFolder.open(run).digest()[:16]
    files = sorted(path for path in run.rglob("*") if path.is_file()) if run.is_dir() else [run]
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.relative_to(run).as_posix().encode() + read(file))
    return digest.hexdigest()[:16]
