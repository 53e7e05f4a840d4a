"""Checks that every game must pass, for use in a game's own tests.

    def test_my_game():
        astray.testing.check_game(my_package.GAME)

The checks derive everything from the game's actions, goals and abilities. A failed check raises
AssertionError.
"""

import functools
import logging
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from astray.acting import LASTING, initial_states, steps
from astray.analysis.policies import Walk
from astray.envs.compiled import compiled_loop
from astray.envs.single import GameEnv
from astray.envs.vector import GameVectorEnv
from astray.game import MUTATIONS, OWN, Game, Variant
from astray.level import EMPTY, Level
from astray.record import COMMON, NEVER, trusted
from astray.validation import shown

LOG = logging.getLogger("astray")
SLOW = 15  # seconds of CPU time for compiling a game; astray's own take 8 to 17
SHORT, LONG = 30, 70  # steps of a shortened episode, and of a test with several of them
INTERPRETED = 10  # steps that are interpreted: a drawing of single pixels takes 50 ms
LEVELS = range(5)  # checked levels of each variant
DRAWN = "all random numbers come from `s`, and every pixel is written"  # what else can differ


def check_game(game: Game, variants: Iterable[str] | None = None) -> None:
    """Check that a game works in environments, training and analysis.

    The compile time of its batch loop is logged, with a warning if it exceeds SLOW seconds.

    Args:
        variants: Names of the variants to check; by default all.

    Raises:
        AssertionError: If a check fails.
    """
    check_parts(game)
    report_compiling(game)
    for name in game.variants if variants is None else variants:
        for check in CHECKS:
            check(game, game.variant(name))


def report_compiling(game: Game) -> None:
    """Log the seconds that compiling the batch loop takes, with a warning if there are many."""
    before = time.process_time()
    compiled_loop(game)
    seconds = time.process_time() - before
    LOG.info("%s: compiled, or taken from the cache, in %.1f s", game.name, seconds)
    if seconds > SLOW:
        warnings.warn(
            f"{game.name} took {seconds:.0f} s to compile, more than {SLOW}: docs/extending.md, "
            '"Compile in seconds", says what takes long',
            stacklevel=3,
        )


def check_parts(game: Game) -> None:
    """Check that events are fields, that there is art, and that variants are of one class."""
    assert isinstance(game, Game), f"a game must be a Game, not its name; got {shown(game)}"
    kinds: Any = {name: game.state[name] for name in game.state.names or ()}
    for event in game.events:
        assert kinds.get(event) == np.int64, f"the event {event!r} must be an int64 of the state"
    assert OWN in game.looks, f"looks must have {OWN!r}; got {', '.join(game.looks)}"
    of = (*{type(variant) for variant in game.variants.values()},)
    assert len(of) == 1 and issubclass(of[0], Variant), f"variants must be of one class; got {of}"


def check_indices(game: Game, variant: Variant) -> None:
    """Check that interpreted code, in which every index is checked, finds all within its arrays.

    Compiled code would end the process or change other memory. Each environment repeats one action.
    """
    begins: dict[str, Any] = {"level": (levels := np.array(LEVELS))}
    actions = levels * len(game.actions) // len(levels)
    for options in reversed(observations(game)):
        env = GameVectorEnv(game, variant, len(levels), **options)
        env._loop = getattr(env._loop, "py_func", env._loop)
        try:
            with np.errstate(all="ignore"):
                env.reset(seed=0, options=begins)
                for _ in range(INTERPRETED if "level" in begins else 1):
                    env.step(actions)
        except IndexError as error:
            *_, last = traceback.extract_tb(error.__traceback__)
            place = f"File {last.filename!r}, line {last.lineno}: {last.line}"
            raise AssertionError(f"{game.name} leaves an array: {error} ({place})") from error
        except Exception as error:
            LOG.warning("no index of %s is checked: interpreted, %s", game.name, shown(error, 300))
            return
        begins = {"state": env.get_state()}  # images of where symbols led


def check_batches(game: Game, variant: Variant) -> None:
    """Check that a batch equals its single environments, in every mode and observation."""
    for mode, options in product(AutoresetMode, observations(game)):
        short = _shortened(variant)
        batch = GameVectorEnv(game, short, 3, autoreset_mode=mode, **options)
        make = functools.partial(GameEnv, game, short, **options)
        single = SyncVectorEnv([make] * 3, autoreset_mode=mode)
        begun = data_equivalence(batch.reset(seed=5), single.reset(seed=5), exact=True)
        assert begun, f"a level begins otherwise when it is begun again: {DRAWN}"
        ended = 0
        for actions in _actions(batch, LONG):
            ours = batch.step(actions)
            assert np.isfinite(ours[1]).all(), f"rewards must be finite numbers; got {ours[1]}"
            assert data_equivalence(ours, single.step(actions), exact=True), (
                f"{mode}: a step differs"
            )
            done = ours[2] | ours[3]
            ended += done.sum()
            if mode is AutoresetMode.DISABLED and done.any():
                seen = batch.reset(options={"reset_mask": done})
                same = single.reset(options={"reset_mask": done.copy()})
                assert data_equivalence(seen, same, exact=True)
        assert ended > 0, f"no episode ended in {LONG} steps with a time limit of {SHORT}"
        batch.close()


def check_gymnasium(game: Game, variant: Variant) -> None:
    """Check a variant with Gymnasium's own checker."""
    check_env(GameEnv(game, variant), skip_render_check=True)


def check_seeds(game: Game, variant: Variant) -> None:
    """Check that equal seeds give equal games, with any number of threads."""
    runs = []
    for threads in (1, 2):
        env = GameVectorEnv(game, variant, 5, threads=threads, autoreset_mode="SameStep")
        seen, _ = env.reset(seed=3)
        for actions in _actions(env, 50):
            seen = env.step(actions)[0]
        runs.append(env.get_state().tobytes() + seen.tobytes())
        env.close()
    assert runs[0] == runs[1], "with two threads something else happened"


def check_levels(game: Game, variant: Variant) -> None:
    """Check that a level depends on its number alone, not on earlier episodes."""
    for options in observations(game):
        env = GameVectorEnv(game, variant, 3, autoreset_mode="Disabled", **options)
        first, _ = env.reset(seed=1, options={"level": [7, 8, 9]})
        begun = env.get_state()
        for actions in _actions(env, 20):
            if env.states["ended"].any():
                break
            env.step(actions)
        for name in {"turn", *(game.state.names or ())} - (COMMON - {"turn"}) - {"gap"}:
            env._states[name] = 1  # as an episode before may have left it
        again, info = env.reset(options={"level": [9, 8, 7]})
        for name in {*(game.state.names or ())} - {"seed", "turn"}:
            same = np.array_equal(begun[name], env.get_state()[name][::-1])
            assert same, f"`generate` takes {name!r} from `turn`, or from what no state holds"
        assert np.array_equal(first, again[::-1]), f"the level began in another way: {DRAWN}"
        assert info["level"].tolist() == [9, 8, 7]


def check_time_limit(game: Game, variant: Variant) -> None:
    """Check that an episode which is not terminated is truncated exactly at the time limit."""
    env = GameVectorEnv(game, _shortened(variant), 8, autoreset_mode="SameStep")
    env.reset(seed=0)
    age = np.zeros(8, np.int64)
    for actions in _actions(env, LONG):
        _, _, terminated, truncated, _ = env.step(actions)
        age += 1
        assert (truncated == (~terminated & (age == SHORT))).all(), f"at steps {age}: {truncated}"
        age[terminated | truncated] = 0


def check_states(game: Game, variant: Variant) -> None:
    """Check that a saved and restored state plays on identically and satisfies `invariants`."""
    one, two = (GameVectorEnv(game, variant, 3, autoreset_mode="SameStep") for _ in range(2))
    seen, _ = one.reset(seed=1)
    for actions in _actions(one, 30):
        seen = one.step(actions)[0]
    assert np.array_equal(two.set_state(one.get_state()), seen), "it is seen otherwise"
    for actions in _actions(one, 30):
        assert data_equivalence(one.step(actions), two.step(actions), exact=True), (
            "it goes on otherwise"
        )


def check_observing(game: Game, variant: Variant) -> None:
    """Check that what is seen leaves the state as it is: it is the same however one looks."""
    envs = [GameVectorEnv(game, variant, 3, **options) for options in observations(game)]
    for env in envs:
        env.reset(seed=1)
    for actions in _actions(envs[0], 20):
        told = [env.get_state() for env in envs]
        for env in envs:
            env.set_state(told[0])
            told.append(env.get_state())
            env.step(actions)
        for name in game.state.names or ():
            same = all(np.array_equal(one[name], told[0][name]) for one in told)
            assert same, f"what draws or writes planes changes {name!r}"


def check_events(game: Game, variant: Variant) -> None:
    """Check that each event is reported once, with its step, and is never taken back.

    A step also leaves the level's number and the other common fields as they are.
    """
    env = GameVectorEnv(game, variant, 8, autoreset_mode="Disabled")
    env.reset(seed=0)
    for actions in _actions(env, LONG):
        if env.states["ended"].any():
            env.reset(options={"reset_mask": env.states["ended"].copy()})
        before = env.get_state()
        env.step(actions)
        for event in game.events:
            was, now, time = before[event], env.states[event], env.states["time"]
            assert ((now == was) | ((was == NEVER) & (now == time))).all(), f"{event}: {now}"
        for name in ("level", "shifted", "time_limit", "seed", "turn"):
            assert np.array_equal(before[name], env.states[name]), f"`step` changes {name!r}"


def check_symbols(game: Game, variant: Variant) -> None:
    """Check that symbols are within their largest values, and planes of 0 and 1 come first."""
    if not game.symbols:
        return
    several = (game.symbols.planes(variant).max((1, 2)) > 1).tolist()
    assert several == sorted(several), "planes of 0 and 1 must come first, as the mlp takes them"
    env = GameVectorEnv(game, variant, 3, observation="symbolic")
    seen = [env.reset(seed=0)[0], *(env.step(actions)[0] for actions in _actions(env, 20))]
    assert all(one in env.observation_space for one in seen), (
        "symbols are larger than `planes` says"
    )


def check_editing(game: Game, variant: Variant) -> None:
    """Check that a level survives being described, drawn and parsed again."""
    if not game.editing:
        return
    its = game.editing
    if lacks := {EMPTY, *its.OBJECTS.values(), *its.STOOD_ON} - its.LEGEND.keys():
        raise AssertionError(f"the legend lacks {', '.join(sorted(lacks))}")
    for s in initial_states(game, variant, LEVELS):
        level = Level.of(game, variant, s)
        told = game.editing.describe(s)
        assert told["grid"] == game.editing.grid(s).tolist()
        assert told["agent"] == game.editing.centre(s)
        built = level.state(solvable=False)
        assert game.editing.describe(built) == told
        for name in {*(game.state.names or ())} - COMMON - {"gap"}:
            assert s.shifted or np.array_equal(built[name], s[name]), (
                f"`describe` and `build` lose {name!r} of level {s.level}"
            )
        assert Level.from_json(game, variant, level.to_json()).to_json() == level.to_json()
        drawn = Level.from_text(game, variant, str(level))
        assert (drawn.cells == level.cells).all() and drawn.agent == level.agent


def check_mutation(game: Game, variant: Variant) -> None:
    """Check that edited levels are the variant's, depend on their seeds, and have no number."""
    if not game.mutation:
        return
    begun = initial_states(game, variant, LEVELS)
    before, seeds = begun.tobytes(), np.arange(len(begun), dtype=np.uint32)
    for kind in MUTATIONS:
        one, two = (game.mutation.mutate(begun, variant, seeds, 5, kind) for _ in range(2))
        assert begun.tobytes() == before, "the states given were changed"
        assert one.tobytes() == two.tobytes(), f"{kind}: equal seeds give other edits"
        assert len(one) == len(begun) and (one["level"] == NEVER).all(), f"{kind}: {one['level']}"
        game.check(one, variant)


def check_solver(game: Game, variant: Variant) -> None:
    """Check that experts obtain the solver's optimal return, and never more.

    They end in cells that the agent can reach, and earn a single reward as soon as possible.
    """
    if not game.solver:
        return
    rewarded = {shift.intended for shift in game.shifts.values()}
    for begun, goal in product(initial_states(game, variant, LEVELS), game.event_goals):
        level = begun.level
        worth, soon = (game.solver.optimal_return(begun, goal, gamma) for gamma in (1.0, 0.9))
        if not worth:
            continue
        walk, s = Walk(goal, observations(game)[-1]["observation"]), begun
        total, discounted, times = 0.0, 0.0, 0
        longest = min(variant.time_limit, LASTING)  # a life without end ends with its goal
        until = [game.event(goal)]
        for step in steps(walk, game, variant, [level], until=until, longest=longest):
            (s,), (reward,) = step.after, step.rewards
            total, discounted = total + reward, discounted + reward * 0.9 ** (s.time - 1)
            times += reward != 0
        if game.places:
            free, now = game.solver.reachable(begun), np.array([s], game.state)
            ((x, y),) = np.floor(game.places.centre(now)).astype(int)
            assert free.dtype == bool and free[y, x], f"level {level}: ({x}, {y}) is not reachable"
        stays = game.actions[walk.ways(game, trusted(np.array([s])))[0]] == "stay"
        assert s.ended or stays, f"level {level}, {goal}"
        if goal in rewarded:
            assert abs(total - worth) < 1e-9, f"level {level}: {total} instead of {worth}"
            assert discounted <= soon + 1e-9, f"level {level}: sooner than is possible"
            late = f"level {level}: it takes {s.time} steps to {goal}, more than are needed"
            assert times > 1 or discounted >= soon - 1e-9, late


def check_places(game: Game, variant: Variant) -> None:
    """Check that the agent can be put in the allowed cells and that nothing else changes."""
    if not game.places:
        return
    for s in initial_states(game, variant, LEVELS):
        begun, stand = np.array([s], game.state), game.places.stand(s)
        ((x, y),) = np.floor(game.places.centre(begun)).astype(int)
        assert stand.dtype == bool and stand[y, x], f"level {s.level}: it cannot be at ({x}, {y})"
        back = game.places.put(begun, np.array([[x, y]]))
        assert back.tobytes() == begun.tobytes(), "put where it is, it is not as it was"
        cells = np.argwhere(stand)[:, ::-1]
        states = np.repeat(begun, len(cells))
        moved = game.places.put(states, cells)
        assert (states == begun).all(), "the states given were changed"
        assert (np.floor(game.places.centre(moved)) == cells).all(), "it is not where it was put"
        game.check(moved, variant)


def check_cells(game: Game, variant: Variant) -> None:
    """Check that agents and goals are in free cells, and reached goals at the agent."""
    if not game.cells:
        return
    for s in initial_states(game, variant, LEVELS):
        free = game.cells.free(s)
        (start,) = np.floor(game.places.centre(np.array([s], game.state))).astype(int)
        assert free.dtype == bool and free[start[1], start[0]]
        for goal in game.event_goals:
            place = game.cells.target(s, goal)
            assert place is None or free[place[1], place[0]], f"level {s.level}: {goal} at {place}"
            if place and game.solver:
                there = _where_reached(game, variant, s, goal)
                assert there in (None, tuple(place)), f"level {s.level}: {goal} reached at {there}"


def check_labels(game: Game, variant: Variant) -> None:
    """Check that labels and features are booleans, integers or reals, one per state."""
    states = np.array(list(initial_states(game, variant, LEVELS)), game.state)
    for name, label in game.labels.items():
        values = label(states)
        assert values.shape == states.shape and values.dtype.kind in "biuf", f"{name}: {values}"
    for name, values in (game.features(states) if game.features else {}).items():
        assert values.shape == states.shape and values.dtype.kind == "f", f"{name}: {values}"


def check_measures(game: Game, variant: Variant) -> None:
    """Check that measures are real numbers, one per final state."""
    env = GameVectorEnv(game, variant, len(LEVELS), autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": np.array(LEVELS)})
    env.step(next(_actions(env, 1)))
    states = env.get_state().view(np.recarray)
    for name, measure in game.measures.items():
        values = measure(states)
        assert np.shape(values) == states.shape, f"{name}: {values}"
        assert np.asarray(values).dtype.kind in "biuf", f"{name}: {values}"


def _where_reached(game: Game, variant: Variant, s: Any, goal: str) -> tuple[int, int] | None:
    """Return the cell where an expert reaches `goal`; None if another goal ends the level first."""
    walk, event = Walk(goal, observations(game)[-1]["observation"]), game.event(goal)
    *_, last = steps(walk, game, variant, [s.level], until=[event])
    x, y = game.places.centre(last.after)[0]
    return (int(x), int(y)) if last.after[event][0] >= 0 else None


def check_compiled_once(game: Game, variant: Variant) -> None:
    """Check that the batch loop is compiled only once for the game."""
    for options in observations(game):
        env = GameVectorEnv(game, variant, 2, **options)
        env.reset(seed=0)
        actions = np.zeros(2, np.int64)
        env.step(actions)
        actions.flags.writeable = False
        env.step(actions)
        env.picture(32)  # another size, and a small one: art is drawn for it
    loop = compiled_loop(game)
    assert len(getattr(loop, "signatures", [0])) == 1, f"compiled for {loop.signatures}"  # pyrefly: ignore


CHECKS: tuple[Callable[[Game, Variant], None], ...] = (
    check_indices, check_batches, check_gymnasium, check_seeds, check_levels, check_time_limit,
    check_states, check_observing, check_events, check_symbols, check_editing, check_mutation,
    check_solver, check_places, check_cells, check_labels, check_measures, check_compiled_once,
)  # fmt: skip


def observations(game: Game) -> list[dict[str, Any]]:
    """Return the kinds of observations that a game has, as options of its environments."""
    return [{"observation": kind} for kind in ("image", *(["symbolic"] if game.symbols else []))]


def _shortened(variant: Variant) -> Variant:
    """Return the variant with short episodes, also in the levels that it shifts to."""
    shifted = variant.shifted and replace(variant.shifted, time_limit=SHORT)
    return replace(variant, time_limit=SHORT, shifted=shifted)


def _actions(env: GameVectorEnv, steps: int) -> Iterator[np.ndarray]:
    """Draw actions [N] for a number of steps, the same in each call."""
    random = np.random.default_rng(0)
    yield from random.integers(len(env.game.actions), size=(steps, env.num_envs))
