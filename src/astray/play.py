"""A window for playing a game, with the agent's observation beside it."""

from collections.abc import Collection

import numpy as np

from astray import imports
from astray.acting import Answer, Onward
from astray.envs.vector import IMAGE, PICTURE, GameVectorEnv
from astray.game import OWN, Game, Variant
from astray.level import Level
from astray.record import LEVELS

VIEW = 256  # pixels a side of the agent's view, enlarged
GAP, TEXT = 16, 18  # pixels
STEPS_PER_SECOND = 15
KNOWN = {"left", "right", "down", "up", "stay"}  # words of actions that arrows and space stand for
HELP = (
    "arrows or WASD: move",
    "space: wait",
    "R: this level again",
    "N: the next level",
    "Esc: leave",
)


def play(game: Game, variant: Variant, level: int | Level | None = None, art: str = OWN) -> None:
    """Open a window and play level after level, from `level` on or from a random one.

    After a drawn `Level`, numbered levels follow from 0. Time stops until the first key is
    pressed; in turn-based games it stops between keys.

    Raises:
        ImportError: If pygame is not installed.
        RuntimeError: If there is no screen.
    """
    with imports.extra("play", "playing needs pygame-ce"):
        import pygame

    env = GameVectorEnv(game, variant, art=art, autoreset_mode="Disabled")
    current = int(np.random.default_rng().integers(LEVELS.stop)) if level is None else level
    pygame.font.init()
    try:
        pygame.display.init()
        if pygame.display.get_driver() == "offscreen":  # which SDL takes if there is no screen
            raise RuntimeError("playing needs a screen, and there is none here")
        screen = pygame.display.set_mode((PICTURE + VIEW + 3 * GAP, PICTURE + 2 * GAP))
        pygame.display.set_caption(f"astray {game.name}")
        font, clock = pygame.font.Font(None, TEXT + 4), pygame.time.Clock()
        seen, _ = env.reset(seed=0, options={"level": current})
        total, ended, running = 0.0, False, True
        while running:
            restart, tapped = False, set()  # keys that were also released since the last step
            for event in pygame.event.get():
                if event.type == pygame.QUIT:
                    running = False
                if event.type == pygame.KEYDOWN:
                    tapped.add(event.key)
                    running &= event.key != pygame.K_ESCAPE
                    if event.key == pygame.K_n:
                        current = 0 if isinstance(current, Level) else current + 1
                        current %= LEVELS.stop
                    restart |= event.key in (pygame.K_n, pygame.K_r)
            action = _action(env, pygame.key.get_pressed(), tapped, pygame)
            if action is None and env.game.real_time and env.states[0].time > 0:
                action = env.game.actions.index("stay")
            if restart:
                seen, _ = env.reset(options={"level": current})
                total, ended = 0.0, False
            elif action is not None and not ended:
                step = Onward(env, seen).step(0, 0, Answer(np.array([action])))
                seen, total, ended = step.seen, total + step.rewards[0], bool(step.ended[0])
            lines = _lines(env, total, ended)
            _paint(screen, env, seen[0], lines, font, pygame)
            pygame.display.flip()
            clock.tick(STEPS_PER_SECOND)
    finally:
        pygame.quit()
        env.close()


def _action(env: GameVectorEnv, held, tapped: Collection[int], pygame) -> int | None:
    """Return the action for the keys that are held or were tapped, or None without keys."""

    def pressed(key: int) -> bool:
        return held[key] or key in tapped

    across = (pressed(pygame.K_RIGHT) or pressed(pygame.K_d)) - (
        pressed(pygame.K_LEFT) or pressed(pygame.K_a)
    )
    up = (pressed(pygame.K_UP) or pressed(pygame.K_w)) - (
        pressed(pygame.K_DOWN) or pressed(pygame.K_s)
    )
    words = [("left", "", "right")[across + 1], ("down", "", "up")[up + 1]]
    words = [word for word in (*words, "stay" * pressed(pygame.K_SPACE)) if word]
    further = [name for k, name in enumerate(_further(env.game)) if pressed(pygame.K_1 + k)]
    names = ("-".join(words[:2]), *words, *further)  # not all games have diagonals
    return next((env.game.actions.index(n) for n in names if n in env.game.actions), None)


def _further(game: Game) -> list[str]:
    """Return the actions, such as "pick", that keys from 1 on stand for."""
    # Procgen's buttons, of a letter each, do nothing.
    return [name for name in game.actions if len(name) > 1 and not KNOWN & {*name.split("-")}]


def _lines(env: GameVectorEnv, total: float, ended: bool) -> list[str]:
    """Return the text in the window."""
    s = env.states[0]
    events = [f"{name}: step {s[name]}" for name in env.game.events if s[name] >= 0]
    state = "ended; R or N" if ended else f"step {s.time} of {s.time_limit}"
    level = f"level {s.level}" if s.level >= 0 else "a level from a file"
    further = [f"{k}: {name}" for k, name in enumerate(_further(env.game), 1)]
    return [level, state, f"return {total:g}", *events, "", *HELP, *further]


def _paint(screen, env: GameVectorEnv, seen: np.ndarray, lines: list[str], font, pygame) -> None:
    """Draw the picture for people, the agent's enlarged view and `lines`."""
    screen.fill((24, 24, 27))
    big = np.ascontiguousarray(env.picture(PICTURE)[0].swapaxes(0, 1))
    screen.blit(pygame.surfarray.make_surface(big), (GAP, GAP))
    repeats = VIEW // IMAGE
    small = seen.swapaxes(0, 1).repeat(repeats, 0).repeat(repeats, 1)
    left = PICTURE + 2 * GAP
    screen.blit(pygame.surfarray.make_surface(small), (left, GAP))
    for k, line in enumerate(lines):
        text = font.render(line, True, (228, 228, 231))
        screen.blit(text, (left, VIEW + 2 * GAP + k * TEXT))
