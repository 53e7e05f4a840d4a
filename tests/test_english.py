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
SCRIPTS = [*ROOT.glob("src/**/*.js"), *ROOT.glob("docs/*.js")]
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
    """Return the docstrings, errors, labels and sentences of a module, with their lines."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or ""
        elif isinstance(node, ast.Raise):
            yield node.lineno, " ".join(words(node.exc))
        elif isinstance(node, ast.keyword) and node.arg in LABELS:
            yield node.value.lineno, " ".join(words(node.value))
        elif isinstance(node, ast.JoinedStr | ast.Constant):
            said = "_".join(words(node))
            if len(said.split()) > 2:
                yield node.lineno, said


def script_texts(text: str) -> Iterator[str]:
    """Return the comments and strings of JavaScript; a comment of several lines is one text."""
    for block in re.findall(r"(?:^[ \t]*//.*\n)+", text, re.MULTILINE):
        yield " ".join(line.strip(" \t/") for line in block.splitlines())
    yield from re.findall(r"\S[ \t]+//(.*)", text)
    yield from ("".join(pair) for pair in re.findall(r'"([^"\n]*)"|`([^`]*)`', text))


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


def test_pages_of_the_lab_are_in_the_words_of_the_field():
    found = {
        f"{path.relative_to(ROOT)}: {fault}"
        for path in SCRIPTS
        for text in script_texts(path.read_text())
        for fault in faults(text)
    }
    assert SCRIPTS and not found


@pytest.mark.parametrize(
    "script",
    ["// What is seen, and\n// by whom.\n", "x = 1; // a film of it\n", 'say("a film of it");\n',
     "say(`It goes astray.`);\n"],
)  # fmt: skip
def test_comments_and_strings_of_scripts_are_read(script):
    assert [fault for text in script_texts(script) for fault in faults(text)]


@pytest.mark.parametrize(
    "module",
    ['"""What is seen."""', 'raise ValueError("the film is old")', 'Plot(title="films")',
     'CAPTION = f"{n} short films of {m}"', 'warn("no film is here")'],
)  # fmt: skip
def test_docstrings_errors_labels_and_sentences_of_modules_are_read(module, tmp_path):
    (tmp_path / "module.py").write_text(module)
    assert [fault for _, text in texts(tmp_path / "module.py") for fault in faults(text)]


@pytest.mark.parametrize("verb", VERBS)
def test_help_is_in_the_words_of_the_field_and_has_an_example(verb, astray, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "400")
    with pytest.raises(SystemExit):
        astray(verb, "--help")
    said = re.sub(r"\x1b\[[\d;]*m|[─│╭╮╰╯]|  +", "\n\n", capsys.readouterr().out)
    assert not faults(said)
    assert f"Example: astray {verb}" in said
