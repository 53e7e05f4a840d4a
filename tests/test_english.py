"""Docstrings, documentation, help, labels and errors use plain words of the field."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from astray.cli.verbs import VERBS

ROOT = Path(__file__).parent.parent
PAGES = [*ROOT.glob("docs/*.md"), *ROOT.glob("*.md"), *ROOT.glob("benchmarks/*.md")]
MODULES = [*ROOT.glob("src/**/*.py"), *ROOT.glob("benchmarks/*.py")]
TEMPLATES = [*ROOT.glob("src/astray/**/*.html"), *ROOT.glob("src/astray/**/*.md")]
LABELS = ("about", "claim", "help", "label", "question", "title", "x_label", "y_label")

# A question may begin so, and a heading, which ends without a stop.
OPENING = re.compile(r"(What|Who|Whoever|How|Of|That)\b.*[.:!;]$")
RETIRED = {
    r"kept agents?": "pretrained agent",
    r"films?|filmed": "video",
    r"shares? of": "fraction of, or rate",
    r"telling (levels?|apart)|(tells?|told) the goals apart": "distinguishing level",
    r"(goes|go|went|gone|going) astray": "misgeneralizes",
    r"doubts?|doubtful": "uncertainty",
    r"judges?|judged|judgements?": "policy and value, or assess",
    r"paints?|painted": "draw, or background",
    r"laps?": "barrier, or round",
    r"minds|pursuits?": "agents, or goals",
    r"see_[a-z]+": "check_x",
    r"claims? (that )?(holds?|held)|(did|does) not hold": "is (not) supported",
    r"likewise": "also",
    r"what (an?|the|its|each|some) layers? gives?": "activation",
    r"(not|is|are|was|were) told": "stated, or distinguished",
    r"less (its|the|that|without|what)": "minus",
    r"shares": "rates, or fractions",
    r"whoever": "one who",
    r"all else": "everything else",
    r"(comes?|came) about": "occurs",
    r"no \w+ any more": "no longer",
}
WORD = re.compile("|".join(rf"\b(?:{word})\b" for word in RETIRED), re.IGNORECASE)
# Other senses of a retired word.
ALLOWED = {"docs/names.md": ("pursuit",), "docs/lab-answers.md": ("pursuit",)}


def sentences(text: str) -> Iterator[str]:
    """Return the sentences of a text, without code, signs of Markdown and tags."""
    text = re.sub(r"```.*?```|`[^`]*`|<[^>]*>|\]\([^)]*\)", "_", text, flags=re.DOTALL)
    for part in re.split(r"(?<=[.!?])[\s*_]+|\n\s*\n|\||\n\s*(?:[-#>*]|\d+\.)\s*", text):
        yield " ".join(part.split()).lstrip("#*-_>[ ")


def faults(text: str) -> list[str]:
    """Return what is wrong in a text: the openings of sentences, and the retired words."""
    found = [sentence[:60] for sentence in sentences(text) if OPENING.match(sentence)]
    return found + [word.group() for one in sentences(text) for word in WORD.finditer(one)]


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Return the docstrings, errors and labels of a module, with their lines."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or ""
        elif isinstance(node, ast.Raise):
            yield node.lineno, " ".join(words(node.exc))
        elif isinstance(node, ast.keyword) and node.arg in LABELS:
            yield node.value.lineno, " ".join(words(node.value))


def words(node: ast.AST | None) -> Iterator[str]:
    """Return the constant strings in an expression."""
    for part in ast.walk(node) if node else ():
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            yield part.value


@pytest.mark.parametrize(
    "text, fault",
    [
        ("What of levels may predict it.", "What of levels may predict it."),
        ("It ends. Of those, one stays.", "Of those, one stays."),
        ("A kept agent runs.", "kept agent"),
        ("| a | How it went. |", "How it went."),
        ("The share of steps.", "share of"),
        ("`see_x` and `film` are code. What is it?", None),
        ("Two processes share one. Agents that others published.", None),
    ],
)
def test_the_rules_find_what_they_are_for(text, fault):
    assert faults(text) == ([fault] if fault else [])


def test_documentation_is_in_the_words_of_the_field():
    found = {
        f"{path.relative_to(ROOT)}: {fault}"
        for path in [*PAGES, *TEMPLATES]
        for fault in faults(path.read_text())
        if fault.lower() not in ALLOWED.get(str(path.relative_to(ROOT)), ())
    }
    assert not found


def test_docstrings_errors_and_labels_are_in_the_words_of_the_field():
    found = {
        f"{path.relative_to(ROOT)}:{line}: {fault}"
        for path in MODULES
        for line, text in texts(path)
        for fault in faults(text)
    }
    assert not found


@pytest.mark.parametrize("verb", VERBS)
def test_help_is_in_the_words_of_the_field_and_has_an_example(verb, astray, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "400")
    with pytest.raises(SystemExit):
        astray(verb, "--help")
    said = re.sub(r"\x1b\[[\d;]*m|[─│╭╮╰╯]|  +", "\n\n", capsys.readouterr().out)
    assert not faults(said)
    assert f"Example: astray {verb}" in said
