"""Pages of the site that are made from the code: games, experiments, agents, verbs, modules.

A hook of MkDocs. Nothing lists what there is; a new game, experiment, verb or module has its page.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import itertools
import os
import pkgutil
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

from gallery import gallery as all_worlds
from gallery import played
from links import api_page, for_site
from markdown.extensions.toc import slugify
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from PIL import Image

import astray
from astray import cli, games
from astray.cli import verbs
from astray.envs.vector import GameVectorEnv
from astray.experiments import catalogue
from astray.experiments.spec import Plan
from astray.game import Game, Variant
from astray.lab.agents import Agents
from astray.lab.export import export
from astray.lab.serving import make_lab
from astray.training import folders
from astray.training.config import Config
from astray.variant import knobs

ROOT = Path(__file__).parents[1]
SIDE = 256  # pixels of a level's picture
WIDTH = "90"  # characters of a help text
LAB_LEVELS, FIRST_LEVEL = 100, 17  # of the lab that is shown on the site
FIRST = f"game=maze&variant=anywhere-small&agent=maze-corner&level={FIRST_LEVEL}"
FINDINGS = ("results.md", "published.md", "what-helps.md", "field-worlds.md", "agency.md")
MOST = 40  # rows of settings; a sweep may have more agents


FETCHED = re.compile(
    r'<(?:script|img|iframe|video|source|link)\b[^>]*\b(?:src|href)="(?:https?:)?//[^>]*'
)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the pages that are made from the code to the reference, the navigation's last part."""
    parts = {
        part: [page for page in pages() if page.startswith(part + "/")]
        for part in ("games", "experiments", "agents", "api")
    }
    titles = {"games": "Games", "experiments": "Studies", "agents": "Agents", "api": "API"}
    made = [{titles[part]: paths} for part, paths in parts.items()]
    *first, reference = config.nav or []
    (title,) = reference
    config.nav = [*first, {title: ["cli.md", *made, *reference[title]]}]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for name, text in pages().items():
        files.append(File.generated(config, name, content=text))
    for game in map(games.find, games.OWN):
        for name, image in pictures(game):
            files.append(File.generated(config, name, content=image))
    for name in folders.pretrained():
        for path in (
            p for p in folders.find(name).iterdir() if p.suffix in (".png", ".gif", ".csv")
        ):
            files.append(
                File.generated(config, f"agents/{name}/{path.name}", abs_src_path=str(path))
            )
    return files


def on_post_build(config: MkDocsConfig) -> None:
    """Write the lab beside the pages; see that no page fetches anything from elsewhere."""
    lab = make_lab(None, {"level": FIRST_LEVEL})
    export(lab, Path(config.site_dir) / "lab", LAB_LEVELS, games=played())
    for path in Path(config.site_dir).rglob("*.html"):
        if found := FETCHED.search(path.read_text()):
            raise PluginError(f"{path} would fetch something: {found[0]}")


@functools.cache
def pages() -> dict[str, str]:
    """All pages that are made: their paths and Markdown."""
    return {
        "index.md": with_lab(from_root("README.md")),
        "speed.md": from_root("benchmarks/README.md"),
        "changelog.md": from_root("CHANGELOG.md"),
        "security.md": from_root("SECURITY.md"),
        **{f"games/{name}.md": game_page(games.find(name)) for name in games.OWN},
        **{f"experiments/{name}.md": experiment_page(name) for name in catalogue.NAMES},
        "agents/index.md": kept_page(),
        **{f"agents/{name}/card.md": card(name) for name in folders.pretrained()},
        "cli.md": verbs_page(),
        **dict(api_pages()),
    }


def with_lab(text: str) -> str:
    """Return a page with the lab below its first sentence, and the gallery after what to try."""
    heading, about, rest = text.split("\n\n", 2)
    first, later = rest.split("\n## Your own\n", 1)
    return "\n".join([
        heading, "", about, "",
        f'<iframe class="lab" src="lab/index.html?embedded#{FIRST}" '
        'title="The lab: drag the cheese, and see where the mouse would go"></iframe>',
        "", "*A mouse that was trained with its cheese in the upper right corner, live in your "
        "browser. Drag the cheese: the arrows are what the mouse would do. "
        "[More of the lab](lab.md).*",
        "", first,
        "", "## Every world, live", "",
        "Drag things, hand over to the agent, or play with the arrow keys. "
        "Nothing runs but your browser.", "",
        all_worlds(), "", "## Your own", later,
    ])  # fmt: skip


@functools.cache
def kept() -> dict[str, dict[str, Any]]:
    """Return what the lab tells of each pretrained agent, by its name."""
    agents = Agents.of({})
    return {name: agents.about(name) for name in folders.pretrained()}


def card(name: str) -> str:
    """The card of a pretrained agent, with a link to the level of its video in the lab."""
    text = (folders.find(name) / "README.md").read_text()
    about = kept()[name]
    address = f"../../lab/index.html#game={about['game']}&variant={about['test']}&agent={name}"
    picture = "(episode.gif)\n"
    return text.replace(
        picture, picture + f'\n<a href="{address}">Play it in the lab</a>, and move things.\n', 1
    )


def in_lab(plan: Plan) -> str:
    """A link to the lab with an experiment's test levels, where a pretrained agent sees such."""
    for name, about in kept().items():
        for test in plan.tests.values():
            if about["game"] == plan.game.name and test.variant in (
                about["test"],
                about["variant"],
            ):
                words = f"game={about['game']}&variant={test.variant}&agent={name}"
                link = (
                    f'<a href="../lab/index.html#{words}">Levels of this experiment in the lab</a>'
                )
                return f"{link}, with the pretrained agent `{name}`."
    return ""


def from_root(name: str) -> str:
    """A text of the repository, its links those of the site."""
    return for_site((ROOT / name).read_text(), str(Path(name).parent))


# Games


def game_page(game: Game) -> str:
    kind = type(next(iter(game.variants.values())))
    told = inspect.getdoc(sys.modules[f"{games.__name__}.{game.name}"]) or ""
    title, _, about = told.partition(": ")
    parts = [
        f"# {title}", about[:1].upper() + about[1:],
        "## Shifts",
        "What an agent is trained on, what it is tested on, and which goals come apart between.",
        table(
            ("shift", "training variant", "test variant", "intended goal", "proxies"),
            [(code(name), code(s.train), code(s.test), s.intended, ", ".join(s.proxies))
             for name, s in game.shifts.items()],
        ),
        "## Goals and events",
        "Rules report events, with the step of each; a goal is reached when its event happens.",
        table(("event", "goals"), [
            (code(event), ", ".join(g for g, e in game.goals.items() if e == event))
            for event in game.events
        ]),
        "## Variants",
        "A variant is a distribution of levels: these knobs, set to numbers. What differs from the "
        "knobs' defaults is named; the picture is the variant's level 0.",
        gallery(game),
        table(("variant", "levels", "knobs"), [
            (code(name), variant.about, ", ".join(map(code, changed(variant))))
            for name, variant in game.variants.items()
        ]),
        "## Knobs",
        inspect.getdoc(kind),
        "Set on the command line as `--set name=value`, in code with `dataclasses.replace`.",
        table(("knob", "type", "default", "meaning"), list(knob_rows(kind))),
        "## Actions",
        ", ".join(f"{number} {code(action)}" for number, action in enumerate(game.actions)) + ".",
    ]  # fmt: skip
    return "\n\n".join(str(part) for part in parts)


def gallery(game: Game) -> str:
    shown = [
        f'<figure><img src="{game.name}/{name}.png" alt="level 0 of {name}">'
        f"<figcaption>{name}</figcaption></figure>"
        for name in drawn(game)
    ]
    return '<div class="pictures">\n' + "\n".join(shown) + "\n</div>"


def drawn(game: Game) -> list[str]:
    """The variants with pictures: of a series that differs in a number only the first."""
    firsts = itertools.groupby(game.variants, lambda name: re.sub(r"\d+$", "", name))
    return [next(names) for _, names in firsts]


def pictures(game: Game) -> Iterator[tuple[str, bytes]]:
    """Level 0 of each variant."""
    for name in drawn(game):
        env = GameVectorEnv(game.name, name, 1, observation="symbolic")
        env.reset(seed=0, options={"level": 0})
        file = io.BytesIO()
        Image.fromarray(env.picture(SIDE)[0]).save(file, "PNG", optimize=True)
        env.close()
        yield f"games/{game.name}/{name}.png", file.getvalue()


def changed(variant: Variant) -> list[str]:
    """The knobs that are not at their defaults."""
    plain = {f.name: f.default for f in fields(variant)}
    return [
        f"{name}={getattr(variant, name)}"
        for name in knobs(type(variant))
        if getattr(variant, name) != plain[name]
    ]


def knob_rows(kind: type[Variant]) -> Iterator[tuple[str, ...]]:
    hints = knobs(kind)
    for field in fields(kind):
        if field.name in hints:
            said = next(filter(None, (comment(owner, field.name) for owner in kind.__mro__)), "")
            default = "" if field.default is MISSING else code(field.default)
            hint = hints[field.name]  # without its bounds
            shown = " ".join(map(code, getattr(hint, "__args__", [hint.__name__])))
            yield code(field.name), shown, default, said[:1].upper() + said[1:]


def comment(owner: type, field: str) -> str:
    """Return what the source says behind the declaration of a field, or above it."""
    if owner is object:
        return ""
    line = rf"^(?:    # (.*)\n)?    {field}: [^#\n]*(?:# (.*))?$"
    found = re.search(line, inspect.getsource(owner), re.MULTILINE)
    return (found[2] or found[1] or "") if found else ""


# Experiments


def experiment_page(name: str) -> str:
    experiment = catalogue.load(name)
    module = sys.modules[catalogue.MODULES[name]]
    parts = [
        f"# {experiment.title}",
        inspect.getdoc(module),
        f"*{experiment.question}* Reproduces: {experiment.reproduces}.",
        "\n".join(
            ["```bash", *(f"astray reproduce {name} --size {s}" for s in experiment.sizes), "```"]
        ),
        "Run again, it goes on where it stopped; agents are shared with the experiments that want "
        "the same. The report is one HTML file with claims, figures, tables and videos.",
        found_in(name, experiment.title),
    ]
    links = filter(None, map(in_lab, experiment.sizes.values()))
    parts += [*dict.fromkeys(links)]
    for size, plan in experiment.sizes.items():
        parts += [f"## Size {size}", *size_parts(plan)]
    return "\n\n".join(map(str, parts))


def found_in(name: str, title: str) -> str:
    """Links to an experiment's claims in the register, and to the pages that say what it found."""
    claims = f"../register.md#{slugify(f'{name}: {title}', '-')}"
    found = []
    for page in FINDINGS:
        text = (ROOT / "docs" / page).read_text()
        if f"`{name}`" in text:
            heading = text.partition("\n")[0].removeprefix("# ")
            found.append(f"[{heading}](../{page})")
    where = f", and what was found: {', '.join(found)}" if found else ""
    return f"See [the claims, their bounds and outcomes]({claims}){where}."


def size_parts(plan: Plan) -> Iterator[str]:
    if plan.differences:
        # Those of several studies are a list, as "maze corner: 15 million steps; keys ...: ...".
        names = "|".join(re.escape(name) for name in plan.agents)
        several = re.split(rf"(?:^|; )(?=(?:{names}): )", plan.differences) if names else []
        listed = "".join(f"\n\n- {one}" for one in several[1:])
        yield f"Other than in the paper: {listed or plan.differences}."
    if plan.published:
        named = ", ".join(f"`{agent}`" for agent in plan.published.values())
        yield (
            f"Nothing is trained. Agents [that others published](../published.md) or that come "
            f"with astray: {named}. "
            f"Levels of each test: {plan.levels:,}."
        )
    elif plan.agents:
        yield (
            f"Agents that are trained: {len(plan.agents) * plan.seeds}, of each name with "
            f"{plan.seeds} {'seed' if plan.seeds == 1 else 'seeds'}. Levels of each test: "
            f"{plan.levels:,}."
        )
        names = list(settings(plan.config))
        some = itertools.islice(plan.agents.items(), MOST)
        rows = [(name, *settings(config).values()) for name, config in some]
        yield table(("agent", *names), rows)
    tests = {**plan.tests, **plan.visited}
    if tests:
        rows = [
            (name, link(plan.game.name, test.variant), code(test.shift), assigned(test.knobs))
            for name, test in tests.items()
        ]
        yield table(("test", "variant", "shift", "knobs changed"), rows)
    if not (plan.differences or plan.published or plan.agents or tests):
        yield "No agent is trained or played: the study makes all that it measures."


def settings(config: Config) -> dict[str, str]:
    """What tells agents apart, for a table."""
    return {
        "variant": link(config.game, config.variant),
        "knobs changed": assigned(config.knobs),
        "steps": f"{config.steps:,}"
        if config.steps < 10**6
        else f"{config.steps / 1e6:g}\u00a0million",
        "sees": config.observation,
        "network": f"{config.network}, {config.scale} x"
        if config.network == "impala"
        else f"{config.network}, {config.width} units",
    }


def assigned(knobs: Mapping[str, Any]) -> str:
    return " ".join(code(f"{name}={value}") for name, value in knobs.items())


def link(game: str, variant: str) -> str:
    return f"[{code(variant)}](../games/{game}.md#variants)"


# Agents, verbs, modules


def kept_page() -> str:
    rows = [
        (f"[{name}]({name}/card.md)", text.split("\n\n")[1].replace("\n", " "))
        for name in folders.pretrained()
        for text in [(folders.find(name) / "README.md").read_text()]
    ]
    return (
        (folders.PRETRAINED / "README.md").read_text()
        + "\n\n"
        + (table(("agent", "what it is"), rows) if rows else "There is none yet.")
    )


def verbs_page() -> str:
    text = "# Commands\n\n" + (inspect.getdoc(cli) or "") + "\n"
    for verb in verbs.VERBS:
        text += f"\n## {verb}\n\n```text\n{help_of(verb)}\n```\n"
    return text


def help_of(verb: str) -> str:
    """What `astray VERB --help` prints."""
    out, env = io.StringIO(), {"COLUMNS": WIDTH, "NO_COLOR": "1"}
    with (
        mock.patch.object(sys, "argv", ["astray", verb, "--help"]),
        mock.patch.dict(os.environ, env),
        contextlib.redirect_stdout(out),
        contextlib.suppress(SystemExit),
    ):
        cli.main()
    return out.getvalue().strip()


def api_pages() -> Iterator[tuple[str, str]]:
    """A page for each package of the first level, and one for the modules beside them."""
    by_page: dict[str, list[str]] = {}
    for module in ["astray", *sorted(modules(astray))]:
        by_page.setdefault(api_page(module), []).append(module)
    for page, names in sorted(by_page.items(), key=lambda item: item[0] != api_page("astray")):
        title = "astray" + ("." + Path(page).stem if page != api_page("astray") else "")
        parts = [f"# {title}", *(f"::: {name}" for name in names)]
        if names[0] == "astray":
            parts.insert(2, face())
        yield page, "\n\n".join(parts)


def face() -> str:
    """A table of the names of `astray` itself, with links to their descriptions."""
    rows = []
    for name, where in sorted(astray.FACE.items(), key=lambda item: item[0].lower()):
        there = getattr(astray, name)
        path, about = where.replace(":", "."), ""
        if isinstance(there, dict):
            about = "Settings by name: " + ", ".join(map(code, there))
        elif callable(there):  # which may be written elsewhere
            path, about = f"{there.__module__}.{name}", inspect.getdoc(there) or ""
        rows.append((f"[`astray.{name}`][{path}]", about.partition("\n")[0]))
    return table(("name", "purpose"), rows)


def modules(package: ModuleType) -> Iterator[str]:
    """The public modules in a package, tests and main programs left out."""
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not re.search(r"\.(_|tests\b)", module.name):
            yield module.name


def table(heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown, without the columns that are empty."""
    columns = [column for column in zip(heading, *rows, strict=True) if any(column[1:])]
    lines = zip(*((name, "---", *cells) for name, *cells in columns), strict=True)
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines)


def code(text: Any) -> str:
    return f"`{text}`"
