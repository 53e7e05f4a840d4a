"""The command line: one plain function per verb."""

from __future__ import annotations

import argparse
import functools
import json
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import polars as pl
import tyro
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, arg

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.experiments.spec import Size
from astray.game import LEVELS, NEVER, Game, Variant
from astray.level import Level, read_levels
from astray.training.config import PRESETS, Config, vary

Preset = Literal["paper", "small"]
Mode = Literal["sampled", "greedy"]
Knobs = Annotated[tuple[str, ...], arg(name="set", metavar="KNOB=VALUE")]
MISTAKE = 2  # exit code, after the mistake was explained
AT_ONCE = 10_000_000  # level numbers of one command


def list_(json: bool = False) -> None:
    """What there is: games, variants, shifts, experiments, presets.

    Args:
        json: print JSON
    """
    from astray import experiments

    found = {
        "games": {
            name: {
                "about": game.about,
                "variants": {k: v.about for k, v in game.variants.items()},
                "goals": list(game.goals),
                "shifts": {k: vars(v) for k, v in game.shifts.items()},
            }
            for name in games.NAMES
            for game in [games.load(name)]
        },
        "experiments": {name: experiments.load(name).title for name in experiments.NAMES},
        "presets": list(PRESETS),
    }
    if json:
        _print_json(found)
        return
    console = Console()
    for name, game in found["games"].items():
        console.print(f"[bold]{name}[/]: {game['about']}")
        table = Table("variant", "levels", box=None, padding=(0, 2))
        for variant, about in game["variants"].items():
            table.add_row(variant, about)
        console.print(table)
        for shift, what in game["shifts"].items():
            goals = f"{what['intended']}, or {' or '.join(what['proxies'])}?"
            console.print(f"  shift {shift}: {what['train']} -> {what['test']}: {goals}")
    console.print("[bold]experiments[/]")
    for name, title in found["experiments"].items():
        console.print(f"  {name}: {title}")


def play(
    game: Positional[str],
    variant: Positional[str],
    level: int | None = None,
    level_file: Path | None = None,
    unsolvable: bool = False,
    knobs: Knobs = (),
) -> None:
    """Play a game in a window, what an agent sees of it beside.

    Args:
        level: the first level's number; by default one at random
        level_file: a level to play first; `astray level` prints such
        unsolvable: let the level have objects that cannot be reached
        knobs: of the variant, changed
    """
    from astray.play import play as window

    kind = _variant(game, variant, knobs)
    window(game, kind, _level(game, kind, level, level_file, unsolvable))


def train(
    config: Annotated[Config, arg(name="")],
    preset: Preset = "small",
    knobs: Knobs = (),
    seeds: int = 1,
    folder: Path | None = None,
) -> None:
    """Train agents, or go on where they stopped.

    Args:
        preset: whose settings are the defaults of all others
        knobs: of the variant, changed
        seeds: agents to train one after the other, with this seed, the next, ...
        folder: of the runs; by default runs/<game>-<variant>
    """
    from dataclasses import replace

    from astray.training.loop import train as run

    if seeds < 1:
        raise ValueError(f"seeds is {seeds}; it is at least 1")
    changed = replace(config, knobs=_pairs(knobs))
    there = folder or Path("runs") / f"{config.game}-{config.variant}"
    for seed in range(config.seed, config.seed + seeds):
        last = run(replace(changed, seed=seed), there / f"seed-{seed}")
        print(last)


def evaluate(
    runs: Positional[tuple[Path, ...]],
    variant: str | None = None,
    shift: str | None = None,
    levels: str | None = None,
    unsolvable: bool = False,
    mode: Mode = "sampled",
    knobs: Knobs = (),
    batch: int = 256,
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Play agents on explicit levels and say which goal they pursued.

    Args:
        runs: run folders, or checkpoints in them; several agents of one kind
        variant: of the levels; by default the shift's test variant
        shift: which goals are intended and proxies; by default the one that the run trained for
        levels: numbers and ranges, as 5,17,100:200, or a file or folder of levels as
            `astray level` prints them; by default the first 1,000 numbers that the first run's
            training does not draw from
        unsolvable: let levels from files have objects that cannot be reached
        mode: draw from the agent's policy, or take the likeliest action
        knobs: of the variant, changed
        batch: episodes at once; the rows do not depend on it
        out: a Parquet file for the episodes, a row each
        json: print JSON
    """
    from astray.analysis.runs import evaluate_runs

    chosen = None
    if levels:
        chosen = Path(levels) if Path(levels).exists() else level_numbers(levels)
    shares, episodes = evaluate_runs(
        runs, chosen, variant=variant, shift=shift, mode=mode, knobs=_pairs(knobs), batch=batch,
        solvable=not unsolvable,
    )  # fmt: skip
    if out:
        episodes.write_parquet(out)
    if json:
        _print_json(shares.to_dicts())
    else:
        _show(shares)


def reproduce(
    name: Positional[str],
    size: Size = "smoke",
    folder: Path = Path("reports"),
    workers: int | None = None,
) -> None:
    """Do a figure or table of the paper: train, evaluate, report; go on where it stopped.

    Args:
        name: of the experiment, as `astray list` has them, or all
        size: smoke (minutes on two cores), hour (of a GPU), or paper
        folder: of reports; gets this one in <name>-<size>, and the agents, which are shared
        workers: agents trained at once; by default one for each processor
    """
    from astray.experiments import run

    if name == "all":
        print(run.reproduce_all(size, folder, workers=workers))
    else:
        print(run.reproduce(name, size, folder, workers=workers))


def record(
    run: Positional[Path],
    variant: str | None = None,
    level: int | None = None,
    level_file: Path | None = None,
    unsolvable: bool = False,
    mode: Mode = "sampled",
    knobs: Knobs = (),
    pixels: int = 512,
    out: Path = Path("episode.mp4"),
) -> None:
    """Film an agent in one level.

    Args:
        run: a run folder or a checkpoint in it
        variant: of the level; by default that of the training
        level: its number; by default 1000000
        level_file: the level instead; `astray level` prints such
        unsolvable: let it have objects that cannot be reached
        mode: draw from the agent's policy, or take the likeliest action
        knobs: of the variant, changed
        pixels: a side of the picture
        out: an .mp4 or .gif file
    """
    from astray.analysis import video
    from astray.analysis.runs import open_run, playing

    write = {".mp4": video.write_mp4, ".gif": video.write_gif}.get(out.suffix)
    if write is None:
        raise ValueError(f"a video is an .mp4 or a .gif file, not {out}")
    agent, config = open_run(run, mode)
    made = playing(config, variant or config.variant, _pairs(knobs))
    begun = _level(config.game, made, level, level_file, unsolvable)
    if begun is None:
        begun = 1_000_000
    episode = video.play(agent, config.game, made, begun, pixels=pixels)
    write(episode.frames, out)
    print(out)


def level(
    game: Positional[str],
    variant: Positional[str],
    numbers: str = "0",
    knobs: Knobs = (),
    text: bool = False,
    json: bool = False,
) -> None:
    """Print levels, as drawings or as data; other verbs read both from files.

    Args:
        numbers: numbers and ranges, as 5,17,100:200
        knobs: of the variant, changed
        text: print drawings alone, without their headings
        json: print JSON, a level a line
    """
    kind, made = _variant(game, variant, knobs), games.load(game)
    for s in _states(game, kind, level_numbers(numbers)):
        if json:
            _print_json(
                {"game": game, "variant": variant, "level": int(s.level)} | made.describe(s)
            )
        else:
            heading = "" if text else f"; {game} {variant} level {s.level}\n"
            print(f"{heading}{Level.of(made, kind, s)}\n")


def replay(
    game: Positional[str],
    variant: Positional[str],
    actions: Path,
    level: int | None = None,
    level_file: Path | None = None,
    unsolvable: bool = False,
    knobs: Knobs = (),
    json: bool = False,
) -> None:
    """Play given actions in one level and tell what happens, step by step.

    Args:
        actions: a file of action names or numbers, separated by white space or commas; - for
            standard input
        level: its number
        level_file: the level instead; `astray level` prints such
        unsolvable: let it have objects that cannot be reached
        knobs: of the variant, changed
        json: print JSON
    """
    from astray.analysis.replay import replay as run

    made = games.load(game)
    text = sys.stdin.read() if str(actions) == "-" else actions.read_text()
    kind = _variant(game, variant, knobs)
    begun = _level(game, kind, level, level_file, unsolvable)
    if begun is None:
        raise ValueError("name a --level or a --level-file")
    told = run(game, kind, begun, _actions(made, text))
    if json:
        number = level if level_file is None else str(level_file)
        _print_json({"game": game, "variant": variant, "level": number} | told)
        return
    for k, step in enumerate(told["steps"], 1):
        print(f"{k:5}  {step['action']:10}  ({step['x']:g}, {step['y']:g})  {step['reward']:+g}")
    print(f"return {told['return']:g}, " + ("terminated" if told["terminated"] else
          "truncated" if told["truncated"] else "not ended"))  # fmt: skip


def overlap(
    game: Positional[str],
    training: Positional[str],
    test: Positional[str],
    training_levels: str = "0:100000",
    test_levels: str = "100000:101000",
    knobs: Knobs = (),
    json: bool = False,
) -> None:
    """Count the levels of a test that are those of the training, under other numbers.

    Args:
        training: the variant trained on
        test: the variant tested on
        training_levels: numbers and ranges, as 5,17,100:200
        test_levels: likewise
        knobs: of both variants, changed
        json: print JSON
    """
    from astray.analysis.overlap import overlap as count

    shared = count(
        game, _variant(game, training, knobs), level_numbers(training_levels),
        _variant(game, test, knobs), level_numbers(test_levels),
    )  # fmt: skip
    if json:
        _print_json(shared.to_dicts())
        return
    table = Table("same", "different in training", "different in test", "of the test seen")
    for row in shared.to_dicts():
        table.add_row(row["same"], f"{row['training']:,}", f"{row['test']:,}", f"{row['seen']:.1%}")
    Console().print(table)


def agency(
    run: Positional[Path],
    variant: str | None = None,
    shift: str | None = None,
    levels: str | None = None,
    measure: Literal["paper", "calibrated"] = "calibrated",
    mode: Mode = "sampled",
    knobs: Knobs = (),
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Say whether a trained agent of mazes is goal-directed at all, and towards what.

    Args:
        run: a run folder or a checkpoint in it
        variant: of the levels; by default the shift's test variant
        shift: which goals are intended and proxies; by default the one that the run trained for
        levels: numbers and ranges, as 5,17,100:200; by default the first 300 that the training
            does not draw from
        measure: calibrated, or the paper's to the letter, which calls most policies agents
        mode: draw from the agent's policy, or take the likeliest action
        knobs: of the variant, changed
        out: a folder for episodes.parquet, and for posterior.mp4, .gif and .png of the episode in
            which most steps tell the goals apart
        json: print JSON
    """
    from astray.analysis.agency_run import judge_run

    chosen = level_numbers(levels) if levels else None
    judged, film = judge_run(
        run, chosen, variant=variant, shift=shift, measure=measure, mode=mode, knobs=_pairs(knobs)
    )
    if out:
        from PIL import Image

        from astray.analysis import video

        frames = film()
        video.write_mp4(frames, out / "posterior.mp4", fps=4)
        video.write_gif(frames, out / "posterior.gif", fps=4)
        Image.fromarray(frames[-1]).save(out / "posterior.png")
        judged.episodes.write_parquet(out / "episodes.parquet")
    if json:
        _print_json(judged.summary())
        return
    table = Table("explanation", "of episodes")
    for name, share in zip(judged.explanations, judged.shares, strict=True):
        table.add_row(name, f"{share.mean:.1%} [{share.low:.1%}, {share.high:.1%}]")
    Console().print(table)
    print(judged.sentence())


def bench(
    what: Positional[Literal["environments", "training", "agency", "start"]] = "environments",
    markdown: bool = False,
    device: Literal["cpu", "cuda", "mps"] = "cpu",
) -> None:
    """Measure speed, as ratios in one run, and where there are others against them.

    Args:
        markdown: print the table for benchmarks/README.md
        device: that trains; the environments and the agency measure are a CPU's
    """
    from importlib import import_module

    from astray.agents.policy import usable

    if not usable(device):
        raise ValueError(f"there is no device {device!r} that torch can use")
    if device != "cpu" and what != "training":
        raise ValueError(f"device is {device!r}; {what} is measured on a CPU")
    module = import_module(f"astray.bench.{what}")
    rows = module.measure(device=device) if what == "training" else module.measure()
    if markdown:
        print(module.markdown(rows))
    else:
        Console().print(module.table(rows))


def level_numbers(text: str) -> np.ndarray:
    """Level numbers from text like 5,17,100:200."""
    spans = []
    try:
        for part in text.split(","):
            first, colon, after = part.partition(":")
            spans.append(
                range(int(first), int(after)) if colon else range(int(first), int(first) + 1)
            )
    except ValueError:
        raise ValueError(f"levels are numbers and ranges as 5,17,100:200; given {text!r}") from None
    spans = [span for span in spans if span]
    if not spans or any(s[0] < 0 or s[-1] >= LEVELS.stop for s in spans):
        raise ValueError(f"levels are numbers from 0 to {LEVELS.stop - 1}; given {text!r}")
    count = sum(map(len, spans))
    if count > AT_ONCE:
        raise ValueError(f"{count} levels are given; at most {AT_ONCE} are taken at once")
    return np.concatenate([np.arange(span.start, span.stop) for span in spans])


def _pairs(knobs: tuple[str, ...]) -> dict[str, Any]:
    wrong = [knob for knob in knobs if "=" not in knob]
    if wrong:
        raise ValueError(f"a knob is set as NAME=VALUE; given {wrong[0]!r}")
    return dict(knob.split("=", 1) for knob in knobs)


def _variant(game: str, variant: str, knobs: tuple[str, ...]) -> Variant:
    return vary(game, variant, _pairs(knobs))


def _level(
    game: str, variant: Variant, number: int | None, file: Path | None, unsolvable: bool
) -> int | Level | None:
    """The level that was asked for by number or file; None where neither was."""
    if file is None:
        return number
    if number is not None:
        raise ValueError("a level is given by its number or in a file, not both")
    found = read_levels(file, games.load(game), variant, solvable=not unsolvable)
    if len(found) > 1:
        raise ValueError(f"one level is played; {file} holds {len(found)}")
    return next(iter(found.values()))


def _states(game: str, variant: Variant, levels: np.ndarray) -> np.ndarray:
    env = GameVectorEnv(game, variant, len(levels), observation="symbolic")
    env.reset(seed=0, options={"level": levels})
    return env.states


def _actions(game: Game, text: str) -> list[int]:
    """Actions by name or number."""
    found = []
    for word in text.replace(",", " ").replace("[", " ").replace("]", " ").split():
        name = word.strip("\"'")
        number = int(name) if name.isdecimal() else NEVER
        if name in game.actions:
            number = game.actions.index(name)
        if not 0 <= number < len(game.actions):
            there = ", ".join(f"{k} {a}" for k, a in enumerate(game.actions))
            raise ValueError(f"unknown action {name!r}; there are: {there}")
        found.append(number)
    return found


def _print_json(data: Any) -> None:
    print(json.dumps(data))


def _show(shares: pl.DataFrame) -> None:
    """`outcomes.shares` as a table: a row a policy, a column an outcome, with 95 % intervals."""
    outcomes = shares["outcome"].unique(maintain_order=True).to_list()
    shown = Table("policy", "agents", "levels", *outcomes, title=shares["variant"][0])
    for rows in shares.partition_by("policy", "levels_played", maintain_order=True):
        first = rows.row(0, named=True)
        levels = f"{first['levels']} {first['levels_played']}"
        told = [f"{r['mean']:.1%} [{r['low']:.1%}, {r['high']:.1%}]" for r in rows.to_dicts()]
        shown.add_row(first["policy"], f"{first['agents']}", levels, *told)
    Console(width=120).print(shown)


VERBS = {
    "list": list_,
    "play": play,
    "train": train,
    "evaluate": evaluate,
    "reproduce": reproduce,
    "record": record,
    "level": level,
    "replay": replay,
    "overlap": overlap,
    "agency": agency,
    "bench": bench,
}


def main() -> None:
    """Entry point of the `astray` command."""
    # The preset gives the other settings their defaults, so it is read before them.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    first.add_argument("--preset", nargs="?")
    preset = first.parse_known_args()[0].preset
    defaults = PRESETS.get(preset, PRESETS["small"])  # tyro refuses an unknown one
    verbs = VERBS | {"train": functools.partial(train, config=defaults)}
    try:
        tyro.extras.subcommand_cli_from_dict(
            verbs, prog="astray", description="Find out which goal a trained agent really pursues."
        )
    except (ValueError, OSError, RuntimeError, ImportError, OverflowError) as error:
        print(f"astray: {error}", file=sys.stderr)
        sys.exit(MISTAKE)
    except KeyboardInterrupt:
        sys.exit(130)
