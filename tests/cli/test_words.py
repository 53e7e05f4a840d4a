"""What words of the command line mean, and that each can be read alone."""

import functools
import inspect
import re
import shlex
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import tyro

from astray.cli import guess, settings, verbs
from astray.cli.arguments import pairs
from astray.experiments.sweep.settings import Sweep, axes, changed
from astray.training.config import PRESETS, Config
from astray.validation import command_of
from helpers.flat import options
from helpers.rooms import WORLD

ROOT = Path(__file__).parents[2]
CARDS = ROOT.glob("src/astray/agents/pretrained/**/README.md")
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *CARDS])


def silent(verb):
    """A function with the arguments of a verb, which does nothing."""
    function = verbs.find(verb)
    plain = getattr(function, "func", function)
    nothing = functools.wraps(plain)(lambda *_, **__: None)
    given = getattr(function, "keywords", {})
    return functools.partial(nothing, **given) if given else nothing


@pytest.mark.parametrize("verb", verbs.VERBS)
def test_every_verb_has_a_sentence_and_an_example_that_can_be_typed(verb):
    function = verbs.find(verb)
    text = inspect.getdoc(getattr(function, "func", function))
    assert re.match(r"[A-Z][^\n]*\.\n", text)
    (example,) = re.findall(r"^Example: astray (.*)$", text, re.MULTILINE)
    name, *words = shlex.split(example)
    assert name == verb
    tyro.cli(silent(verb), args=words, config=verbs.MARKERS)


@pytest.mark.parametrize("verb", verbs.VERBS)
def test_the_help_of_every_option_is_a_sentence_with_its_default(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")  # wider, groups stand beside each other
    with pytest.raises(SystemExit):
        tyro.cli(silent(verb), args=["--help"], config=verbs.MARKERS)
    text = re.sub(r" *\n {9,}(?=\S)", "  ", capsys.readouterr().out)  # an entry is a line now
    told = re.findall(r"^  ((?:-|\[?[A-Z]+\]?  ).*?) {2,}(.*\)) *$", text, re.MULTILINE)
    hidden = verb in ("train", "sweep")  # knobs, which are --set
    assert len(told) == len(list(options(verb))) - hidden
    for option, sentence in told:
        ends = r"(default: .+|required|repeatable)"
        assert re.fullmatch(rf"[A-Z].*\. +\({ends}\)", sentence), (option, sentence)
        assert "(default: None)" not in sentence


def test_no_word_is_an_option_and_a_number_of_things_at_once():
    """--set, --shift, --mode, --levels: each has one type in all verbs that have it."""
    for name in (
        "set", "shift", "mode", "out", "track", "seeds", "workers", "level_file", "levels",
        "num_levels", "test_levels", "actions",
    ):  # fmt: skip
        kinds = {
            re.sub(r" \| None|typing.Optional\[|<class '|'>|\]+$", "", str(kind))
            for verb in verbs.VERBS
            for own, kind, _ in options(verb)
            if own == name and verb != "sweep"
        }
        assert len(kinds) == 1, (name, kinds)


def test_a_meaning_has_one_word_in_all_verbs():
    """A result is written to --out; --levels are numbers, and --num-levels is their count."""
    there = {f"--{own}" for verb in verbs.VERBS for own, *_ in options(verb)}
    assert "--out" in there and not there & {*verbs.EARLIER}


@pytest.mark.parametrize("given", ["--numbers 7", "--numbers=7", "--levels 7"])
def test_scripts_with_earlier_names_of_options_go_on(given, astray):
    drawn = astray("level", "maze", "corner-small", "--levels", "7")
    assert astray("level", "maze", "corner-small", *given.split()) == drawn


def test_the_example_of_a_sweep_has_combinations_that_can_be_trained():
    (example,) = re.findall(
        "Example: astray sweep (.*)", inspect.getdoc(verbs.find("sweep").func) or ""
    )
    words = shlex.split(example)
    given = [word for flag, word in pairwise(words) if flag == "--set"]
    config = replace(PRESETS["small"], game=words[0], variant=words[1])
    assert len(Sweep(config, axes(given)).cells()) == 4


def test_set_means_knobs_and_settings_by_their_names():
    base = PRESETS["small"]
    both = changed(base, pairs((("lr=1e-4", "world=5"), ("largest=5",))))
    assert (both.learning_rate, both.knobs) == (1e-4, {"world": 5, "largest": 5})
    assert pairs((("variant.world=5",),)) == {"world": "5"}
    assert changed(base, pairs((("variant.largest=5", "anneal=false"),))).knobs == {"largest": 5}
    shop = PRESETS["small"].changed(game="pottery", variant="corner")  # its knob: a setting's name
    assert changed(shop, pairs((("reward=careful",),))).knobs == {"reward": "careful"}
    assert axes(["lr=1e-4,5e-4", "largest=3,5"]) == axes(["lr=1e-4,5e-4", "variant.largest=3,5"])
    with pytest.raises(ValueError, match="unknown setting or knob 'squid'; there are: game"):
        changed(base, {"squid": 3})
    room = changed(Config(WORLD, "end"), pairs((("lr=1e-4", "place=start"),)))  # its factory's
    assert (room.learning_rate, room.knobs) == (1e-4, {"place": "start"})
    with pytest.raises(ValueError, match=r"takes no such knob: .*'squid'"):
        changed(room, {"squid": 3})


def test_what_was_meant_is_guessed():
    assert guess("unknown variant 'cornr' of maze; there are: corner, anywhere").endswith(
        "; did you mean 'corner'?"
    )
    assert not guess("unknown variant 'xyz' of maze; there are: corner, anywhere")
    assert not guess("no space is left")


def test_the_nearest_name_is_named_for_settings_and_verbs_too(astray):
    assert astray("evaluat", "x", fails=True).endswith("; did you mean 'evaluate'?\n")
    told = astray("train", "maze", "cornr", fails=True)
    assert "unknown variant 'cornr'" in told and told.endswith("did you mean 'corner'?\n")


@pytest.mark.parametrize(
    "given, meant",
    [
        ("reproduce maze-corner --size smok", "--size; there are: .*; did you mean 'smoke'[?]"),
        (
            "evaluate maze-corner --observation imag",
            "--observation; there are: (image, symbolic|symbolic, image); did you mean 'image'[?]",
        ),
        ("train maze corner --preset smallx", "--preset; there are: .*; did you mean 'small'[?]"),
        (
            "agents fech openai-coinrun",
            "what; there are: list, fetch, check; did you mean 'fetch'[?]",
        ),
    ],
)
def test_the_nearest_choice_of_an_option_is_named_in_colour_too(given, meant, monkeypatch):
    verb = given.split()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "40")
    for coloured in (False, True):
        monkeypatch.setattr(sys.stdout, "isatty", lambda coloured=coloured: coloured)
        with pytest.raises(ValueError, match="unknown choice") as refused:
            verbs._parsed(verbs.find(verb[0]), verb)
        line = str(refused.value)
        assert re.fullmatch(f"unknown choice .* for {meant}", line + guess(line))


@pytest.mark.parametrize(
    "given, told",
    [
        ("replay --levels 3", "unknown option '--levels' of replay; did you mean '--level'?"),
        ("train maze corner --lr 1", "'--lr' of train; did you mean '--learning-rate'?"),
        ("train maze corner --lvels=3", "'--lvels' of train; did you mean '--num-levels'?"),
        ("export maze-corner --episodes 3", "of export; it has --levels, --out, "),
        ("list variant", "unknown word 'variant'; usage: astray list [-h] [--json | --no-json]"),
        ("list ''", "each word needs a value; got ''"),
        ("train maze corner more", "word 'more'; usage: astray train [-h] [OPTIONS] [GAME]"),
        ("play coinrn", "unknown game 'coinrn'; there are: boat, "),
        ("play coinrun", "play needs VARIANT; there are: coin-end, "),
        ("replay", "replay needs GAME, VARIANT, --actions; as in astray replay maze corner"),
        ("replay maze corner --actions", "--actions needs a value"),
        ("explain maze-corner --level abc", "--level must be INT; got 'abc'"),
        ("compare maze-corner randm", "policy 'randm'; there are: "),
        (
            "evaluate --policy randm --game maze --shift corner-small",
            "unknown policy 'randm'; there are: random, walk:",
        ),
    ],
)
def test_a_misspelt_or_missing_word_is_told_in_a_line(given, told, astray, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    line = astray(*shlex.split(given), fails=True)
    assert told in line and line.count("\n") == 1
    assert "did you mean" in line or "unknown" not in line or "there are" not in line


def test_settings_of_trainings_are_in_groups_and_each_in_one(capsys):
    with pytest.raises(SystemExit):
        verbs._parsed(verbs.find("train"), ["train", "--help"])
    groups = re.split(r"\n\S* ?(\w+) options", capsys.readouterr().out)
    found = dict(zip(groups[1::2], groups[2::2], strict=True))
    assert list(found) == ["experiment", "levels", "agent", "ppo", "hardware", "sampler", "fast"]
    assert "--gamma " in found["ppo"] and "--num-levels " in found["levels"]
    assert "--validation " in found["experiment"] and "--threads " in found["hardware"]
    for preset in PRESETS.values():
        assert settings.ungrouped(settings.grouped(preset)) == preset


@pytest.mark.parametrize("verb", ["train", "agency"])
def test_help_begins_with_the_verbs_sentence_and_wraps_those_of_options(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    with pytest.raises(SystemExit):
        verbs._parsed(verbs.find(verb), [verb, "--help"])
    said, function = capsys.readouterr().out, verbs.find(verb)
    told = inspect.getdoc(getattr(function, "func", function))
    assert told.splitlines()[0] in said and re.search("Example: astray", said)
    for sentence in re.findall(r"^    \w+: (.*(?:\n {8}.*)*)", told, re.MULTILINE):
        assert re.sub(r"\s+", " ", sentence).rstrip(".") in said


@pytest.mark.parametrize("verb", ["explain", "list", "cache"])
def test_help_is_in_lines_that_a_terminal_can_show(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        verbs._parsed(verbs.find(verb), [verb, "--help"])
    said, function = capsys.readouterr().out, verbs.find(verb)
    assert max(map(len, said.splitlines())) <= 80
    told = inspect.getdoc(getattr(function, "func", function)).split("\n\nArgs:")[0]
    assert " ".join(told.split()) in " ".join(said.split())


@pytest.mark.parametrize("words, line", [
    (["astray", "lab", "runs/mice/seed-0", "--bins=9"], "astray lab runs/mice/seed-0 --bins=9"),
    (["my mice", "it's", "", "@a"], """"my mice" "it's" "" "@a\""""),
    (["runs\\mice", "C:\\my mice\\a"], '"runs\\mice" "C:\\my mice\\a"'),
    (["a$b", "\\\\host\\a b", "a b\\"], "'a$b' '\\\\host\\a b' 'a b\\'"),
])  # fmt: skip
def test_a_command_is_quoted_as_every_shell_reads_it(words, line):
    assert command_of(*words) == line
    assert shlex.split(line) == words


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_pages_can_be_pasted_into_any_shell(page):
    """cmd takes single quotes for letters, and a comment for arguments, as zsh does."""
    text = page.read_text("utf-8")
    blocks = re.findall(r"^```bash\n(?!#!)(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"`((?:astray|pip|python) [^`]*)`", text)
    assert not [line for line in lines if re.search(r"['$]|#|\\$", line)]


@pytest.mark.parametrize(
    "verb, option",
    [(verb, f"--{option}") for verb in ("evaluate", "agency", "compare", "export", "explain")
     for option in ("levels", "variant", "shift", "layers")
     if option in verbs.find(verb).__annotations__ or option in ("variant", "shift")
     if (verb, option) != ("export", "shift")]
    + [("distil", "--network"), ("distil", "--art"), ("train", "--out"), ("record", "--out")],
)  # fmt: skip
def test_an_empty_option_is_no_default(verb, option, astray):
    more = {"compare": ["random"], "distil": ["--observation=image"]}.get(verb, [])
    told = astray(verb, "maze-corner", *more, option, "", fails=True)
    assert told == f"astray: {option} needs a value; got ''\n"


@pytest.mark.parametrize(
    "words",
    [["evaluate", ""], ["lab", ""], ["art", "import", ""], ["list", ""], [""],
     ["record", "maze-corner", "--level-file", ""], ["export", "maze-corner", "--out="]],
)  # fmt: skip
def test_an_empty_word_is_not_the_current_folder(words, astray):
    assert "needs a value; got ''" in astray(*words, fails=True)
