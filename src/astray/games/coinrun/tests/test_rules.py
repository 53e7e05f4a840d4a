"""CoinRun's rules, on rooms drawn in text."""

from dataclasses import replace

import numpy as np
import pytest

from astray.envs.pictures import picture
from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import GAME, measures
from astray.games.coinrun.variants import VARIANTS, CoinRun
from astray.level import Level

END = VARIANTS["coin-end"]
ON = VARIANTS["coin-end-continue"]
ROOM = """
    #..........#
    #..........#
    #..........#
    #..........#
    #..........#
    #..........#
    #..........#
    #@.........#
    ============
"""


def room(bottom, *above):
    """ROOM with other lowest rows."""
    rows = ROOM.strip("\n").splitlines()[: -2 - len(above)]
    return "\n".join([*rows, *(f"    {row}" for row in (*above, bottom)), "    ============"])


def play(drawing, actions, variant=END):
    """Play `drawing`; return all rewards, whether it ended, and the state."""
    env = GameVectorEnv("coinrun", variant, observation="symbolic", autoreset_mode="Disabled")
    env.set_state(Level.from_text(GAME, variant, drawing).state(solvable=False))
    total, over = 0.0, False
    for name in actions.split():
        for _ in range(int(name.partition("*")[2] or 1)):
            if over:
                break
            action = np.array([GAME.actions.index(name.partition("*")[0])])
            _, reward, terminated, truncated, _ = env.step(action)
            total, over = total + float(reward[0]), bool(terminated[0] or truncated[0])
    return total, over, env.states[0]


@pytest.mark.parametrize(
    "actions, x, y",
    [
        ("right", 1.6, 1.5787),
        ("right right", 1.78, 1.5787),
        ("up", 1.5, 3.0787),
        ("up*8", 1.5, 7.9787),  # as high as it gets: 6.4 cells
        ("up*17", 1.5, 1.5787),
        ("up*18", 1.5, 3.0787),  # one step after the landing, the next jump
        ("left*3", 1.5, 1.5787),  # a wall
        ("right*30", 10.5, 1.5787),
        ("stay d a w s q e", 1.5, 1.5787),
    ],
)
def test_the_runner_runs_and_jumps(actions, x, y):
    *_, s = play(ROOM, actions)
    assert (s.x, s.y) == pytest.approx((x, y), abs=1e-4)


def test_crates_stop_falls_alone():
    drawing = room("#@.c.......#")
    assert play(drawing, "right*8")[2].x > 3.5  # through it
    *_, s = play(room("#@.........#", "#c.........#"), "up*5 stay*30")
    assert s.y == pytest.approx(3.5787, abs=1e-4)  # up through it, and onto it
    assert s.on_crate
    *_, s = play(room("#@.........#", "#c.........#"), "up*5 stay*30 up")
    assert s.y == pytest.approx(5.0787, abs=1e-4)  # it can jump from there
    *_, s = play(room("#@.........#", "#c.........#"), "up*5 stay*30 down*9")
    assert s.y == pytest.approx(1.5787, abs=1e-4)  # and down with the key


@pytest.mark.parametrize(
    "thing, event", [("x", "met_saw"), ("<", "met_walker"), (">", "met_walker"), ("~", "met_lava")]
)
def test_hazards_kill_whatever_side_they_are_touched_from(thing, event):
    reward, over, s = play(room(f"#@...{thing}:....#"), "right*40")
    assert (reward, over) == (0, True)
    assert s.died == s[event] == s.time
    causes = {"met_saw", "met_walker", "met_lava"} - {event}
    assert all(s[cause] == -1 for cause in causes)


def test_walkers_turn_at_walls_and_barriers():
    env = GameVectorEnv("coinrun", END, observation="symbolic", autoreset_mode="Disabled")
    drawing = room("#@...:>..:.#")
    env.set_state(Level.from_text(GAME, END, drawing).state(solvable=False))
    seen = []
    for _ in range(100):
        env.step(np.array([4]))
        seen.append(float(env.states["walker_x"][0, 0]))
    assert min(seen) > 6.45 and max(seen) < 8.55
    assert np.ptp(seen) > 1.8 and set(np.sign(np.diff(seen))) == {-1, 1}
    assert np.allclose(env.states["trail_x"][0, 0], seen[:-10:-1])


@pytest.mark.parametrize(
    "walls, speeds",
    [
        (("...:>..#.", "...:...#."), {0.15, 0.1125, 0.1125 * 0.75}),  # WALL
        (("...:>..=.", "...:...=."), {0.15}),  # a wall's top
        (("...:>..:.", "...:...:."), {0.15}),  # a barrier
    ],
)
def test_walls_alone_slow_walkers_down(walls, speeds):
    env = GameVectorEnv("coinrun", END, observation="symbolic", autoreset_mode="Disabled")
    drawing = room(f"#@{walls[0]}#", f"#.{walls[1]}#")
    env.set_state(Level.from_text(GAME, END, drawing).state(solvable=False))
    seen = set()
    for _ in range(65):
        env.step(np.array([4]))
        seen.add(float(abs(env.states["walker_vx"][0, 0])))
    assert np.allclose(sorted(seen), sorted(speeds), rtol=1e-6)


@pytest.mark.parametrize(
    "crate, height, vy, action, speed",
    [
        ("c", 4, -1, "stay", 0.15 / 4),  # one of four parts is gone when the crate stops the rest
        ("c", 4, -1, "left", 0.15 / 4),
        ("c", 4, -1, "down", 0.1125),  # the runner falls through crates
        ("c", 4, -1, "left-down", 0.1125),
        ("c", 4, 1, "stay", 0.1125),  # it rises
        ("c", 2.5, -1, "stay", 0.1125),  # it was not above the crate
        (".", 4, -1, "stay", 0.1125),
    ],
)
def test_a_runner_coming_down_stops_walkers_in_crates(crate, height, vy, action, speed):
    env = GameVectorEnv("coinrun", END, observation="symbolic", autoreset_mode="Disabled")
    drawing = room(f"#@...>.{crate}#..#", "#.......#..#")
    states = Level.from_text(GAME, END, drawing).state(solvable=False)
    s = np.array([states], env.game.state)
    s["walker_x"][0, 0] = 7.46  # its corner comes to the wall at 8 in the second of four parts
    s["y"], s["vy"] = height, vy
    env.set_state(s)
    env.step(np.array([GAME.actions.index(action)]))
    assert env.states["walker_vx"][0, 0] == pytest.approx(-speed, rel=1e-6)


def test_the_coin_is_worth_ten_and_ends_the_level():
    reward, over, s = play(room("#@..o......#"), "right*40")
    assert (reward, over, s.took_coin) == (10, True, s.time)
    assert s.died == -1


def test_going_on_after_the_coin_pays_every_step_that_touches_it():
    reward, over, s = play(room("#@..o......#"), "right*40", ON)
    steps = 4  # at x = 3.84, 4.27, 4.71 and 5.17
    assert (reward, over) == (10 * steps, False)
    assert 0 < s.took_coin < s.passed_coin < s.time


def test_a_coin_cancels_a_death_by_saw_in_the_same_step_when_going_on():
    """It is met after the saw; lava in a later cell still kills."""
    above = "#.o........#"
    _, over, s = play(room("#@x........#", above), "right", ON)
    assert (over, s.died, s.took_coin) == (False, -1, 1)
    assert play(room("#@x........#", above), "right")[1:2] == (True,)
    assert play(room("#@x........#"), "right", ON)[1]
    assert play(room("#@o~.......#"), "right*40", ON)[1]


def test_an_invisible_coin_is_noticed_and_does_nothing():
    reward, over, s = play(room("#@..i......#"), "right*40")
    assert (reward, over) == (0, False)
    assert 0 < s.took_invisible < s.time and s.took_coin == -1


def test_a_permeable_wall_lets_pass():
    variant = VARIANTS["coin-end-permeable"]
    *_, s = play(room("#@...%%%...#"), "right*40", variant)
    assert s.x == pytest.approx(10.5, abs=1e-4)
    assert -1 < s.reached_end <= s.touched_wall < s.passed_wall < s.time
    before, after = (
        play(room("#@...%%%...#"), f"right*{s.passed_wall + k}", variant)[2].x for k in (-1, 0)
    )
    assert before < 8.5 <= after
    *_, s = play(room("#@...###...#"), "right*40", variant)
    assert s.x == pytest.approx(4.5, abs=1e-4) and s.passed_wall == -1


def test_time_runs_out():
    reward, over, s = play(ROOM, "stay*5", replace(END, time_limit=5))
    assert (reward, over, s.timed_out, s.died) == (0, True, 5, -1)


def test_measures_follow_the_runner():
    env = GameVectorEnv("coinrun", "coin-end", 50, observation="symbolic")
    env.reset(seed=0, options={"level": np.arange(50)})
    states = env.states.copy()
    assert np.allclose(measures.progress(states), 0)
    assert (measures.stage(states) == 0).all()
    states["x"], states["y"] = states["end_x"] + 0.5, states["end_y"] + 0.5
    assert np.allclose(measures.progress(states), 1) and (measures.stage(states) == 2).all()
    assert measures.coin_in_view(states).all() and (measures.to_wall(states) == 0).all()
    states["x"] -= 7
    assert (measures.to_wall(states) == 7).all()
    assert not measures.coin_in_view(states).any()
    states["x"] = states["end_x"] + 2
    assert (measures.stage(states) == 3).all()


@pytest.mark.parametrize(
    "knobs, message",
    [
        ({"random_coin": 1.5}, "random_coin must be from 0 to 1; got 1.5"),
        ({"random_coin": 0.5, "coins": "two"}, "given 0.5 with coins 'two'"),
        ({"permeable": 65}, "permeable must be an integer from 0 to 64; got 65"),
        ({"permeable": -1}, "permeable must be an integer from 0 to 64; got -1"),
        ({"difficulty": 4}, "difficulty must be an integer from 0 to 3; got 4"),
        ({"sections": 6}, "sections must be an integer from 0 to 5; got 6"),
        ({"sections": 2.5}, "sections must be an integer .*; got 2.5"),
        ({"coins": "three"}, "unknown coins 'three'; there are: one, two, none"),
        ({"place": "sky"}, "unknown place 'sky'; there are: ledge, anywhere"),
        ({"numbering": "stock"}, "unknown numbering"),
        ({"numbering": "procgen", "random_coin": 0.5}, "have no ledge for a random coin"),
        ({"numbering": "procgen", "coins": "two"}, "have no ledge for a random coin"),
        ({"time_limit": 0}, "time_limit must be an integer from 1 to 2147483647; got 0"),
    ],
)
def test_bad_knobs_are_explained(knobs, message):
    with pytest.raises(ValueError, match=message):
        CoinRun(about="", **knobs)


@pytest.mark.parametrize(
    "field, value",
    [
        ("cell", 9), ("thing", 3), ("detail", 20), ("x", -1.0), ("x", np.nan), ("y", 64.0),
        ("vx", 50.0), ("vy", np.inf), ("pose", 3), ("walkers", 49), ("walker_x", 64.0),
        ("walker_y", -0.5), ("walker_vx", np.nan), ("walker_look", 9), ("trail_x", -9.0),
        ("end_x", 64), ("end_y", -1), ("coin_x", 64), ("coin_y", -2), ("permeable", 64),
        ("runner_look", 5), ("ground", 6), ("background", 62), ("background_offset", 1.5),
        ("mt_next", 624),
    ],
)  # fmt: skip
def test_impossible_states_never_reach_compiled_code(field, value):
    env = GameVectorEnv("coinrun", "coin-end", 2, observation="symbolic")
    env.reset(seed=0)
    states = env.states.copy()
    states[field][1] = value
    with pytest.raises(ValueError, match=field):
        env.set_state(states)
    with pytest.raises(ValueError, match=field):
        picture("coinrun", env.variant, states, 64)


def test_where_the_coin_is_at_the_end_both_are_reached_at_once():
    env = GameVectorEnv(
        "coinrun",
        "coin-end",
        64,
        observation="symbolic",
        levels=range(500),
        autoreset_mode="SameStep",
    )
    env.reset(seed=0)
    onward, rng = (
        [env.game.actions.index(a) for a in ("right", "right-up")],
        np.random.default_rng(0),
    )
    steps = []
    for _ in range(400):
        *_, info = env.step(rng.choice(onward, 64))
        if "final_info" in info:
            final, ended = info["final_info"], info["_final_info"]
            steps += zip(final["took_coin"][ended], final["reached_end"][ended], strict=True)
    assert sum(coin >= 0 for coin, _ in steps) > 50
    assert all(coin == end for coin, end in steps)
