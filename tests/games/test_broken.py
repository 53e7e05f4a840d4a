"""A game of a stranger that is broken is told, and keeps nothing else from being seen."""

import json
import logging
import os
import re
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit
from numba.core.errors import NumbaError

from astray import games, imports, world
from astray.envs.compiled import _brief
from astray.envs.vector import GameVectorEnv
from astray.game import More, Never, Shift
from astray.kernel.jit import kernel
from astray.lab.serving import make_lab
from astray.lab.session import Session
from helpers.guests import offer
from helpers.thorough import thorough

SOURCES = {
    "raises": "raise RuntimeError('it lacks a file')",
    "leaves": "import sys; sys.exit(0)",
    "is_none": "GAME = 3",
    "hides": "class Hidden:\n    def __repr__(self): raise SystemExit(0)\nGAME = Hidden()",
    "fails_unsaid": "class Unsaid(Exception):\n    def __repr__(self): raise SystemExit(0)\n"
    "raise Unsaid",
    "poses": "class Posed:\n    __class__ = property(lambda self: exit())\nGAME = Posed()",
    "ends": "class End(BaseException): pass\nraise End('for good')",
    "leaves_late": "import dataclasses, sys\nfrom astray import games\n"
    "class Variants(dict):\n    items = sys.exit\n"
    "GAME = dataclasses.replace(games.find('maze'), name='leaves_late', "
    "variants=Variants(games.find('maze').variants), shifts={})",
    "misleads_late": "import dataclasses\nfrom astray import games\n"
    "class Odd(ValueError):\n    def __str__(self): raise KeyboardInterrupt\n"
    "class Variants(dict):\n    def items(self): raise Odd\n"
    "GAME = dataclasses.replace(games.find('maze'), name='misleads_late', "
    "variants=Variants(games.find('maze').variants), shifts={})",
    "is_no_text": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='is_no_text', about=b'maze')",
    "is_unsure": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='is_unsure', real_time='no')",
    "is_compared": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='is_compared', benchmark='corner')",
    "is_hollow": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='is_hollow', "
    "variants={'one': 3}, shifts={})",
    "has_no_variants": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='has_no_variants', "
    "variants={}, shifts={})",
    "lacks_rules": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='lacks_rules', rules=None)",
    "has_odd_names": "import dataclasses\nfrom astray import games\nMAZE = games.find('maze')\n"
    "GAME = dataclasses.replace(MAZE, name='has_odd_names', shifts={}, "
    "variants={'a:b': MAZE.variants['corner']})",
    "has_odd_goals": "import dataclasses\nfrom astray import games\n"
    "GAME = dataclasses.replace(games.find('maze'), name='has_odd_goals', goals={3: object()})",
}
REASONS = {
    "raises": "RuntimeError('it lacks a file')",
    "leaves": "SystemExit(0)",
    "is_none": "must be a Game called 'is_none'; got 3",
    "has_odd_names": "must be of letters, digits, _, - and .; got 'has_odd_names' with 'a:b'",
    "hides": "must be a Game called 'hides'; got <Hidden that cannot be shown>",
    "fails_unsaid": "fails: <Unsaid that cannot be shown>",
    "poses": "SystemExit(None)",
    "ends": "End('for good')",
    "leaves_late": "SystemExit()",
    "misleads_late": "fails: Odd()",
    "is_no_text": "about must be a str; got b'maze'",
    "is_unsure": "real_time must be a bool; got 'no'",
    "is_compared": "benchmark must be a Benchmark or None; got 'corner'",
    "is_hollow": "no attribute 'about'",
    "has_no_variants": "variants must be at least one; got none",
    "lacks_rules": "rules of the game 'lacks_rules' must have ACTIONS,",
    "has_odd_goals": "each name of goals must be a str; got 3",
}


@pytest.fixture
def strangers(tmp_path, monkeypatch):
    offer(tmp_path, monkeypatch, **SOURCES)
    yield
    games._offered.cache_clear()


def test_what_is_there_is_listed_beside_broken_games_and_why(strangers, astray):
    found = json.loads(astray("list", "--json"))["games"]
    assert set(games.OWN) <= found.keys()
    for name, reason in REASONS.items():
        assert reason in found[name]["error"]
    said = "".join(astray("list").split())
    assert all("".join(f"{n}: broken:".split()) in said for n in REASONS) and "coinrun" in said


@pytest.mark.parametrize("name", REASONS)
def test_a_broken_game_is_refused_where_it_is_asked_for(strangers, name):
    if name in ("leaves_late", "misleads_late", "is_hollow"):
        assert games.find(name).name == name  # it is broken where it is described
    else:
        with pytest.raises(ValueError, match=re.escape(REASONS[name])):
            games.find(name)


@pytest.mark.parametrize("value", [":GAME", "broken", "bro ken:GAME", "broken::GAME"])
def test_an_entry_point_that_names_no_object_is_refused_with_the_form_of_a_name(
    tmp_path, monkeypatch, value
):
    offer(tmp_path, monkeypatch, broken="GAME = 3")
    entries = tmp_path / "guests-1.dist-info" / "entry_points.txt"
    entries.write_text(f"[{games.GROUP}]\nbroken = {value}\n")
    with pytest.raises(ValueError, match=f"^a name must be module:attribute, .* got '{value}'$"):
        games.find("broken")
    games._offered.cache_clear()


def test_an_interrupt_while_a_game_loads_is_the_users(tmp_path, monkeypatch):
    offer(tmp_path, monkeypatch, waits="import signal\nsignal.raise_signal(signal.SIGINT)")
    for find in (games.find, lambda name: games.survey(str), lambda name: imports.find("waits:X")):
        games._offered.cache_clear()
        with pytest.raises(KeyboardInterrupt):
            find("waits")
    games._offered.cache_clear()


def test_a_game_that_takes_long_to_load_is_named(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(imports, "LONG", 0.01)
    offer(tmp_path, monkeypatch, slow="import time\ntime.sleep(0.3)\nGAME = 3\n")
    with pytest.raises(ValueError, match="must be a Game called 'slow'"):
        games.find("slow")
    assert caplog.messages == ["the module 'slow' is still being imported after 0.01 seconds"]


def test_a_game_that_closes_a_standard_stream_does_not_end_what_follows(tmp_path, monkeypatch):
    module = (
        "import dataclasses, sys\nfrom astray import games\nprint('loaded')\n"
        "GAME = dataclasses.replace(games.find('maze'), name='NAME')\nsys.stdout"
    )
    ends = {"closes": ".close()", "takes": " = None", "mutes": "; sys.stderr.close()"}
    ends["writes"] = "\nimport os; sys.__stdout__.write('late '); os.write(1, b'raw ')"
    offer(tmp_path, monkeypatch, **{n: module.replace("NAME", n) + e for n, e in ends.items()})
    games._offered.cache_clear()
    program = (
        "from astray import games; import sys; "
        f"print(*(games.find(n).name for n in {tuple(ends)})); print('end', file=sys.stderr)"
    )
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": paths},
    )
    assert done.stdout.split() == ["closes", "takes", "mutes", "writes"], done.stderr
    told = ["loaded"] * 4 + ["raw", "late", "end"]
    assert sorted(done.stderr.split()) == sorted(told)  # not amid what a program may read


def test_games_that_replace_functions_of_python_take_nothing_else_down(tmp_path, monkeypatch):
    """In a process of its own: here, a thread may need such a function in the meantime."""
    names = ("builtins.sorted", "json.dumps", "builtins.isinstance", "os.dup2")
    spoils = {
        f"spoils{k}": f"import builtins, json, os\n{name} = None\nGAME = 3"
        for k, name in enumerate(names)
    }
    offer(tmp_path, monkeypatch, **spoils)
    games._offered.cache_clear()
    done = subprocess.run(
        [sys.executable, "-m", "astray", "list", "--json"],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    )
    found = json.loads(done.stdout)["games"]
    assert all("must be a Game" in found[name]["error"] for name in spoils), done.stderr


def test_a_game_that_allows_few_calls_in_each_other_hides_no_other(tmp_path, monkeypatch):
    before = sys.getrecursionlimit()
    try:
        few = "import sys\nsys.setrecursionlimit({})\nGAME = 3"
        offer(tmp_path, monkeypatch, few=few.format(before // 2), many=few.format(2 * before))
        games.survey(lambda game: 0)
        assert sys.getrecursionlimit() == 2 * before  # which a game may need
        with pytest.raises(ValueError), imports.guarded("few"):
            sys.setrecursionlimit(before)
            raise ValueError
        assert sys.getrecursionlimit() == 2 * before
    finally:
        sys.setrecursionlimit(before)
        games._offered.cache_clear()


@pytest.mark.skipif(os.name == "nt", reason="it has no alarms")
def test_a_game_that_sets_an_alarm_a_mask_errors_or_logs_leaves_them_as_they_were(
    tmp_path, monkeypatch
):
    sets = "import logging, os, signal, numpy\nsignal.alarm(100)\nos.umask(0o777)\n"
    sets += "numpy.seterr(all='raise')\nlogging.disable()\nGAME = 3"
    offer(tmp_path, monkeypatch, sets=sets)
    before, mask = np.geterr(), os.umask(0o022)
    try:
        games.survey(lambda game: 0)
        assert (signal.alarm(0), os.umask(0o022), np.geterr()) == (0, 0o022, before)
        assert logging.getLogger("astray").isEnabledFor(logging.WARNING)
        signal.alarm(100)
        with imports.guarded("a game with its own limit of time"):
            pass
        assert signal.alarm(0) > 90
    finally:
        signal.alarm(0)
        os.umask(mask)
        np.seterr(**before)
        logging.disable(logging.NOTSET)
        games._offered.cache_clear()


def test_a_game_that_sets_torch_s_usual_numbers_breaks_no_agent(tmp_path, monkeypatch):
    import torch

    offer(tmp_path, monkeypatch, wide="import torch\ntorch.set_default_dtype(torch.float64)")
    try:
        games.survey(lambda game: 0)
        assert torch.get_default_dtype() == torch.float32
        assert make_lab("maze-corner", {}).agents.about("maze-corner")["game"] == "maze"
    finally:
        torch.set_default_dtype(torch.float32)
        games._offered.cache_clear()


def test_a_game_that_makes_warnings_errors_or_learns_nothing_breaks_no_other(tmp_path, monkeypatch):
    import torch

    sets = "import warnings, torch\nwarnings.simplefilter('error')\ntorch.set_grad_enabled(False)"
    warns = "import dataclasses, warnings\nfrom astray import games\nwarnings.warn('old')\n"
    warns += "GAME = dataclasses.replace(games.find('maze'), name='warns')"
    offer(tmp_path, monkeypatch, sets=sets, warns=warns)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found, broken = games.survey(lambda game: 0)
        assert "warns" in found and [*broken] == ["sets"]
        assert torch.is_grad_enabled()
    finally:
        torch.set_grad_enabled(True)
        games._offered.cache_clear()


@pytest.mark.parametrize("ruin", ["sys.path.clear()", "sys.path[:] = ['here']", "sys.path = None"])
def test_a_game_that_loses_the_path_of_modules_hides_no_game_after_it(tmp_path, monkeypatch, ruin):
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("ruins", "whole"):
        sys.modules.pop(name, None)  # of the case before
    whole = "import dataclasses\nfrom astray import games\n"
    whole += "GAME = dataclasses.replace(games.find('maze'), name='whole')"
    offer(tmp_path, monkeypatch, ruins=f"import sys\n{ruin}\nGAME = 3", whole=whole)
    before = [*sys.path]
    found, broken = games.survey(lambda game: game.name)
    assert "whole" in found and {*broken} == {"ruins"} and {*before} <= {*sys.path}
    games._offered.cache_clear()


def test_a_game_that_changes_the_current_folder_leaves_the_users(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    offer(tmp_path, monkeypatch, moves="import os\nos.chdir('/')\nGAME = 3")
    assert {*games.survey(lambda game: game.name)[1]} == {"moves"} and Path.cwd() == tmp_path
    games._offered.cache_clear()


@pytest.mark.parametrize("words", [("list", "--json"), *thorough((("list", "no-word"),))])
def test_what_a_game_prints_at_the_end_of_python_is_not_in_the_output(tmp_path, monkeypatch, words):
    lasts = "import atexit\natexit.register(print, 'farewell')\nGAME = 3"
    offer(tmp_path, monkeypatch, lasts=lasts)
    games._offered.cache_clear()
    program = "import sys; from astray import cli, imports; imports.find('lasts:GAME'); cli.main()"
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    )
    assert "farewell" in done.stderr and "farewell" not in done.stdout
    assert done.returncode or "lasts" in json.loads(done.stdout)["games"]


def test_a_list_does_not_wait_for_a_thread_of_a_game(tmp_path, monkeypatch):
    waits = "import threading, time\nthreading.Thread(target=time.sleep, args=(600,)).start()"
    offer(tmp_path, monkeypatch, waits=waits)
    games._offered.cache_clear()
    done = subprocess.run(
        [sys.executable, "-m", "astray", "list", "--json"],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        timeout=120,
    )
    assert done.returncode == 0 and "GAME" in json.loads(done.stdout)["games"]["waits"]["error"]


def test_text_that_fails_when_it_is_printed_is_listed_as_text(tmp_path, monkeypatch, astray):
    odd = (
        "import dataclasses\nfrom astray import games\n"
        "class Text(str):\n    def __str__(self): raise RuntimeError\n    __format__ = __str__\n"
        "GAME = dataclasses.replace(games.find('maze'), name='is_odd', about=Text('a riddle'))"
    )
    offer(tmp_path, monkeypatch, is_odd=odd)
    assert "is_odd: a riddle" in astray("list")
    games._offered.cache_clear()


def test_text_is_listed_without_its_markup_or_control_characters(tmp_path, monkeypatch, astray):
    abouts = ["a [/] riddle", "a [bold]riddle", "a riddle\x1b[2J"]
    module = (
        "import dataclasses\nfrom astray import games\nMAZE = games.find('maze')\n"
        "one = MAZE.variant('corner')\n"
        f"these = {{str(n): dataclasses.replace(one, about=x) for n, x in enumerate({abouts})}}\n"
        f"GAME = dataclasses.replace(MAZE, name='is_marked', variants=these, shifts={{}}, "
        f"about={abouts[0] + ' ' + 'x' * 9999!r})"
    )
    offer(tmp_path, monkeypatch, is_marked=module)
    listed = astray("list")
    assert [listed.count(about.replace("\x1b", "\\x1b")) for about in abouts] == [2, 1, 1]
    assert "x" * 400 not in "".join(listed.split())
    (page,) = Session(make_lab("maze-corner", {})).answers('{"id": 1, "kind": "hello"}')
    assert len(page["games"]["is_marked"]["about"]) == 300
    games._offered.cache_clear()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"levels": None}, "levels of the game 'maze' must have"),
        ({"goals": None}, "goals must be a Mapping; got None"),
        ({"goals": {"hole": "fell"}}, "unknown event of a goal 'fell'"),
        ({"ends": {"late": Never("fell")}}, "unknown event of a goal 'fell'"),
        ({"goals": {"many": More("keys")}, "shifts": {}}, "unknown measure of a goal 'keys'"),
        ({"shifts": {"one": 1}}, "a shift must be a Shift; got 1"),
        ({"shifts": {"one": Shift("corner", "no", "cheese", ())}}, "unknown variant of a shift"),
        ({"shifts": {"one": Shift("corner", "corner", "no", ())}}, "unknown goal of a shift"),
    ],
)
def test_a_game_that_names_what_it_lacks_cannot_be_made(wrong, said):
    with pytest.raises(ValueError, match=said):
        replace(games.find("maze"), **wrong)


def test_a_game_whose_code_cannot_be_compiled_is_told():
    maze = games.find("maze")
    rules = SimpleNamespace(**vars(maze.rules) | {"step": lambda s, action: (0.0, False)})
    told = (
        r"code of the game 'plain' fails: Untyped global name 'step.* \(File \".*loops\.py\", line "
    )
    with pytest.raises(ValueError, match=told):
        GameVectorEnv(replace(maze, name="plain", rules=rules), "corner")


@kernel
def masked(s, action):
    s.cell[s.cell > 0] = 1
    return 0.0, False


def test_code_at_which_numba_itself_fails_is_told_with_its_line():
    """A mask of two dimensions was told as AssertionError(), without a place."""
    maze = games.find("maze")
    rules = SimpleNamespace(**vars(maze.rules) | {"step": masked})
    line = masked.__code__.co_firstlineno + 2
    with pytest.raises(ValueError, match=rf"fails: AssertionError.*near .*test_broken.*{line}"):
        GameVectorEnv(replace(maze, name="masked", rules=rules), "corner")


@njit
def misspelt():
    return REWARD  # noqa: F821  # pyrefly: ignore


@njit
def calls():
    return misspelt()


def test_a_name_that_is_not_defined_is_told_with_its_function():
    """The line that was told was that of the call, for a game's step one of our loop."""
    with pytest.raises(NumbaError) as failed:
        calls()
    assert _brief(failed.value).startswith("NameError: name 'REWARD' is not defined")
    assert _brief(failed.value).endswith("(in misspelt)")


@pytest.mark.parametrize("text", [b"[astray.games]\nno sign of equality\n", b"[a]\n\xff = b:C\n"])
def test_a_package_whose_entry_points_cannot_be_read_hides_no_game(strangers, tmp_path, text):
    ruined = tmp_path / "ruined-2.dist-info"
    ruined.mkdir()
    (ruined / "METADATA").write_text("Metadata-Version: 2.1\nName: ruined\nVersion: 2\n")
    (ruined / "entry_points.txt").write_bytes(text)
    with pytest.warns(
        UserWarning, match=r"what ruined offers astray\.games is not seen: its entry"
    ):
        assert set(games.names()) == {*games.OWN, *SOURCES}
    with pytest.warns(UserWarning, match="what ruined offers astray"), pytest.raises(ValueError):
        imports.known("nobody:Net", "astray.networks", object)


@pytest.mark.parametrize(("find", "group"), [(games.find, games.GROUP), (world.find, world.GROUP)])
def test_a_name_that_two_packages_offer_is_neither_of_both(tmp_path, monkeypatch, find, group):
    offer(tmp_path, monkeypatch, one="GAME = 1", two="GAME = 2")
    (tmp_path / "guests-1.dist-info" / "entry_points.txt").write_text(
        f"[{group}]\none = one:GAME\n"
    )
    other = tmp_path / "others-1.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1\n")
    (other / "entry_points.txt").write_text(f"[{group}]\none = two:GAME\n")
    with pytest.raises(ValueError, match=r"'one' is offered by several .*: .*two:GAME"):
        find("one")
    games._offered.cache_clear()


@pytest.mark.parametrize("name", ["room", "other"])
def test_a_world_is_found_by_its_own_name_alone(tmp_path, monkeypatch, name):
    offer(tmp_path, monkeypatch, rooms_offered="from helpers.rooms import WORLD")
    (tmp_path / "guests-1.dist-info" / "entry_points.txt").write_text(
        f"[{world.GROUP}]\n{name} = rooms_offered:WORLD\n"
    )
    if name == "room":
        assert world.find(name).name == "room"
    else:
        with pytest.raises(
            ValueError, match="rooms_offered:WORLD must be a World called 'other'; "
        ):
            world.find(name)


def test_the_first_page_of_the_lab_tells_broken_games_and_why(strangers):
    (about,) = Session(make_lab("maze-corner", {})).answers('{"id": 1, "kind": "hello"}')
    assert set(about["games"]) == set(games.OWN)
    assert all(reason in about["broken"][name] for name, reason in REASONS.items())


def test_art_that_ends_the_program_is_told_before_anything_is_compiled():
    maze = games.find("maze")
    own = replace(maze.looks["own"], art=lambda variant, pixels: sys.exit(0))
    leaves = replace(maze, name="leaves", looks={"own": own})
    with pytest.raises(ValueError, match=r"the art of .* fails: SystemExit\(0\)"):
        GameVectorEnv(leaves, "corner", 1)
