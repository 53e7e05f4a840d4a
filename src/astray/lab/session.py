"""Answers to one page's questions: text in, plain data out."""

import base64
import functools
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from astray import games
from astray.analysis.critic import ask, observe
from astray.analysis.trained import Opaque, check_network
from astray.envs.pictures import picture
from astray.game import Game
from astray.lab import agents, goals
from astray.lab.agents import Agents, rounded
from astray.lab.messages import Message, number_of, read
from astray.lab.worlds import Episode, World, play_on, read_world, snapshot
from astray.validation import brief, one_of
from astray.variant import knobs

FORMAT = 1  # of the messages; goes up when an older page could not read them
STEPS_AT_ONCE = 8  # of an agent's episode, before a page hears of them
VIEW = 256  # pixels a side of the picture of what an agent sees
MISTAKES = (ValueError, OverflowError, MemoryError, ImportError, RuntimeError)
Reply = dict[str, Any]


@dataclass(eq=False)
class Lab:
    """State shared by all pages of one process.

    Attributes:
        start: Initial fields of a `Message`.
    """

    agents: Agents
    start: Mapping[str, Any]
    lock: threading.Lock = field(default_factory=threading.Lock)  # one question at a time


@dataclass(eq=False)
class Session:
    """One page: its questions, and its episode."""

    lab: Lab
    _episode: Episode | None = None
    _world: World | None = None
    _asked: str = ""

    def answers(self, text: Any) -> Iterator[Reply]:
        """Yield the parts of the answer to any message; the last one has "done".

        An invalid message is answered with "error"; an internal error ends only this answer.
        """
        last: Reply = {}
        try:
            message = read(text)
            for part in ANSWERS[message.kind](self, message):
                if last:
                    yield {"id": message.id} | last
                last = part
            yield {"id": message.id} | last | {"done": True}
        except MISTAKES as error:
            yield {"id": number_of(text), "done": True, "error": brief(error)}
        except Exception as error:
            traceback.print_exc(file=sys.stderr)
            said = f"the lab itself failed: {error!r}"
            yield {"id": number_of(text), "done": True, "error": said}

    def world(self, message: Message) -> World:
        """Return the level of a message; the last one is cached."""
        asked = repr((message.game, message.variant, message.knobs, message.level))
        if self._world is None or asked != self._asked:
            self._world, self._asked = read_world(message), asked
        return self._world

    def episode(self, message: Message) -> Episode:
        """Return the episode of a message's actions; the last one is cached."""
        self._episode = play_on(self._episode, self.world(message), message.actions)
        return self._episode


def hello(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with all games, variants and agents, and the initial choice."""
    lab = session.lab
    found, broken = games.survey(about_game)
    agents = {}
    for name in lab.agents.names:
        try:
            agents[name] = lab.agents.about(name)
        except (*MISTAKES, OSError) as error:
            broken[name] = brief(error)
    yield {
        "format": FORMAT, "engine": "python", "games": found, "agents": agents, "broken": broken,
        "start": dict(lab.start),
    }  # fmt: skip


@functools.cache
def about_game(game: Game) -> Reply:
    """Return the page's description of a game."""
    sprites = game.sprites
    return {
        "about": brief(game.about),
        "actions": list(game.actions), "events": list(game.events), "goals": game.event_goals,
        "shifts": {name: vars(shift) for name, shift in game.shifts.items()},
        "variants": {name: brief(v.about) for name, v in game.variants.items()},
        "knobs": {
            name: {knob: getattr(v, knob) for knob in knobs(type(v))}
            for name, v in game.variants.items()
        },
        "legend": dict(game.editing.LEGEND) if game.editing else {},
        "objects": dict(game.editing.OBJECTS) if game.editing else {},
        "real_time": game.real_time,
        "labels": bool(game.labels), "solver": bool(game.solver), "editing": bool(game.editing),
        "floors": list(sprites.FLOORS) if sprites else [],
        "pictures": {c: list(names) for c, names in sprites.PICTURES.items()} if sprites else {},
    }  # fmt: skip


def art(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the SVG drawings of a game, by name."""
    yield {"pictures": drawings(games.find(message.game))}


def drawings(game: Game) -> dict[str, str]:
    """Return a game's drawings as SVG, of its sprites or the files beside its rules."""
    if game.sprites:
        files = dict(game.sprites.DRAWINGS)
    else:
        path = vars(game.rules).get("__file__")
        folder = Path(path).parent / "art" if isinstance(path, str) else None
        files = {file.stem: file for file in sorted(folder.glob("*.svg"))} if folder else {}
    return {name: file.read_text(encoding="utf-8") for name, file in files.items()}


def level(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the level as data and text, its problems, and its initial state."""
    yield session.world(message).told()


def fields(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with policy and value at all places, in the state after the actions."""
    episode = session.episode(message)
    agent = session.lab.agents.of_message(message, episode.world)
    yield from agents.arrows(agent, episode, message.effects)


def play(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the states of the agent's next steps, known ones first.

    The first part has all states of the message's actions.
    """
    episode = session.episode(message)
    world = episode.world
    agent = session.lab.agents.of_message(message, world) if message.agent else None
    yield _told(episode, 0, agent)
    if agent is None or not message.steps or episode.ended:
        return
    told = len(episode.states)
    for k, _ in enumerate(episode.play(agent, message.steps), 1):
        if episode.ended or k % STEPS_AT_ONCE == 0 or k == message.steps:
            yield _told(episode, told, agent)
            told = len(episode.states)


def _told(episode: Episode, first: int, agent: Any) -> Reply:
    """Return the states of an episode from the `first` on, with the agent's values."""
    game, states = episode.world.game, episode.states[first:]
    told: Reply = {
        "first": first,
        "states": [snapshot(game, s[0]) for s in states],
        "actions": episode.actions[max(first - 1, 0) :],
        "rewards": episode.rewards[max(first - 1, 0) :],
        "terminated": episode.terminated,
        "ended": episode.ended,
    }
    if isinstance(agent, Opaque):
        told["value"] = [None] * len(states)
    elif agent is not None:
        # One with memory remembers what it saw before these states, too.
        asked = episode.states if agent.caveat else states
        _, value = ask(agent, episode.world.variant, np.concatenate(asked), episode=True)
        told["value"] = rounded(value[-len(states) :])
    return told


def posterior(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the evidence for each goal so far; raise ValueError without a shift."""
    episode = session.episode(message)
    yield goals.posterior(episode, _shift(session, message, episode.world.game))


def distinguishes(session: Session, message: Message) -> Iterator[Reply]:
    """Answer whether the level distinguishes the goals; raise ValueError without a shift."""
    world = session.world(message)
    shift = _shift(session, message, world.game)
    yield {"distinguishes": goals.distinguishes(world, shift)}


def splay(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the final goals for each place of an object; raise ValueError without a shift."""
    world = session.world(message)
    agent = session.lab.agents.of_message(message, world)
    shift = _shift(session, message, world.game)
    yield from goals.splay(agent, world, message.thing, message.cell, shift, message.draws)


def _shift(session: Session, message: Message, game: Game) -> Any:
    name = session.lab.agents.about(message.agent)["shift"] if message.agent else ""
    found = [s for s in game.shifts.values() if message.variant in (s.train, s.test)]
    shift = game.shifts.get(name) or (found[0] if found else None)
    if shift is None:
        raise ValueError(f"{game.name} must have a shift between goals for this; it has none")
    return shift


def attribution(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the attribution of the value to the observation, [C, H, W] or [H, W]."""
    from astray.insight import attribution as methods

    agent, observations = _seen(session, message)
    method: Callable[..., np.ndarray] = getattr(methods, message.method.replace(" ", "_"))
    yield {"map": rounded(method(agent, observations)[0])}


def view(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the planes that the agent sees, or with a base64 picture of its image."""
    agent, (seen,) = _seen(session, message)
    episode = session.episode(message)
    if agent.observation == "symbolic":
        yield {"planes": seen.tolist()}
        return
    shown = picture(episode.world.game, episode.world.variant, episode.state, VIEW, agent.art)[0]
    yield {
        "side": seen.shape[0],
        "picture": base64.b64encode(shown.tobytes()).decode(),
        "pixels": VIEW,
    }


def _seen(session: Session, message: Message) -> tuple[Any, np.ndarray]:
    """Return the agent and its observation after the actions, [1, ...]."""
    episode = session.episode(message)
    agent = session.lab.agents.of_message(message, episode.world)
    return agent, observe(agent, episode.world.variant, episode.state)


def route(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with the best way to a goal; raise ValueError if the goal is unknown."""
    episode = session.episode(message)
    one_of("goal", message.goal, episode.world.game.goals)
    yield goals.route(episode, message.goal)


def reading(session: Session, message: Message) -> Iterator[Reply]:
    """Answer with a layer's probe readings and true values; raise ValueError without labels."""
    from astray.insight.probes import readings

    episode = session.episode(message)
    world = episode.world
    agent = check_network(session.lab.agents.of_message(message, world))
    seen = session.lab.agents.visited(message.agent, world)
    here = episode.state.copy().view(np.recarray)
    labels = dict(world.game.labels)
    rows: list[Reply] = []
    for row in readings(agent, world.variant, seen, here, [message.layer], labels):
        rows.append(row)
        yield {"rows": [*rows], "states": len(seen)}


ANSWERS: Mapping[str, Callable[[Session, Message], Iterator[Reply]]] = {
    "hello": hello, "art": art, "level": level, "fields": fields, "play": play,
    "posterior": posterior, "splay": splay, "attribution": attribution, "route": route,
    "view": view, "reading": reading, "distinguishes": distinguishes,
}  # fmt: skip
