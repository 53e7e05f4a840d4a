"""Videos of episodes, alone and side by side, as MP4 and GIF."""

import functools
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from astray import acting, games
from astray.acting import LevelByLevel, Policy, Step, check_ending, check_policy, steps
from astray.envs.pictures import PICTURES, picture
from astray.envs.worlds import WorldVectorEnv
from astray.files import write_aside
from astray.game import Game, Variant
from astray.level import Level
from astray.validation import bounded, of_kind
from astray.world import Failed, World, WorldVariant

BACKGROUND, INK = (27, 32, 40), (235, 237, 240)  # dark, to fit light and dark pages
CAPTION = 17  # pixels, the size of its letters
LINE = 24  # pixels from a line of a caption to the next
FASTEST = 100  # frames a second: GIFs count hundredths
LARGEST = 2**32  # bytes of an episode's frames
SIGN = "video by astray"  # a comment in the file
FPS = 15  # frames, and so steps of an episode, a second

Caption = str | Callable[[int], str]  # or a function of the step


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps: frames to look at, observations and states."""

    frames: np.ndarray  # [T + 1, P, P, 3] uint8; of a World as it renders, scaled
    observations: Any  # [T + 1, ...]; uint8 of games
    states: np.ndarray  # [T + 1] records
    rewards: np.ndarray  # [T] float64
    events: dict[str, int | None]  # step at which each first happened, None for never
    level: int  # level number; -1 for a drawn level
    terminated: bool  # ended by the rules; otherwise truncated


def play(
    policy: Policy,
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    level: int | Level,
    *,
    pixels: int = 256,
    longest: int | None = None,
) -> Episode:
    """Play one episode of `policy` in a level and record everything.

    Args:
        pixels: Side of the frames.
        longest: Steps after which it is truncated; None for no limit.

    Raises:
        ValueError: If an argument is invalid, or the frames would take more than 4 GB.
    """
    of_kind("level", level, int | np.integer | Level)
    bounded("pixels", pixels, *PICTURES)
    check_policy(policy)
    if isinstance(game, World):
        game = game.in_every_step
        played, frames = _rendered(policy, game, game.variant(variant), level, pixels, longest)
    else:
        chosen = {"": level} if isinstance(level, Level) else [level]
        variant = (game := games.find(game)).variant(variant)  # pyrefly: ignore
        game.drawn(policy.art, variant)  # told before the work: who sees symbols is drawn, too
        played = [*_fitting(steps(policy, game, variant, chosen, longest=longest), pixels)]
        frames = np.zeros(0)
    last, states = played[-1].after[0], [*(step.before for step in played), played[-1].after]
    states = np.concatenate(states).view(np.recarray)
    if isinstance(game, Game):
        frames = picture(game, variant, states, pixels, policy.art)  # pyrefly: ignore
    return Episode(
        frames=frames,
        observations=_joined([*(step.observations for step in played), played[-1].seen]),
        states=states,
        rewards=np.concatenate([step.rewards for step in played]),
        events={event: int(last[event]) if last[event] >= 0 else None for event in game.events},
        level=-1 if isinstance(level, Level) else int(last["level"]),  # a stream chooses it
        terminated=bool(played[-1].terminated[0]),
    )


def _fitting(played: Iterable[Step], pixels: int) -> Iterator[Step]:
    """Yield steps; raise ValueError if the frames of so many take more than `LARGEST` bytes."""
    most = LARGEST // (3 * pixels**2)
    for k, step in enumerate(played):
        if k == most:
            raise ValueError(
                f"a video of {pixels} pixels a side has at most {most:,} steps, and the episode "
                "goes on: say `longest`, the steps after which it is left"
            )
        yield step


def _rendered(
    policy: Policy, game: World, variant: WorldVariant, level: Any, pixels: int, longest: int | None
) -> tuple[list[Step], np.ndarray]:
    """Play an episode of a World; its steps, and what `render` shows before and after each."""
    check_ending(game, variant, longest)
    env = WorldVectorEnv(game, variant.rendered(), 1, longest)
    stage = LevelByLevel(env, [level], longest=longest)
    played, shown = [], [_enlarged(env.render()[0], pixels)]
    for step in _fitting(acting.telling(policy, stage, 1, longest is None), pixels):
        played.append(step)
        shown.append(_enlarged(env.render()[0], pixels))
        if shown[-1].shape != shown[0].shape:
            raise Failed(f"{variant}, level {level}: images of a video must have one shape")
    return played, np.stack(shown)


def _enlarged(frame: np.ndarray, pixels: int) -> np.ndarray:
    """Scale a frame so that its longer side is `pixels`."""
    scale = pixels / max(frame.shape[:2])
    width, height = (max(1, round(side * scale)) for side in frame.shape[1::-1])
    return np.array(Image.fromarray(frame).resize((width, height), Image.Resampling.NEAREST))


def _joined(parts: Sequence[Any]) -> Any:
    """Concatenate arrays, or those of each name or place."""
    if isinstance(parts[0], Mapping):
        return {name: _joined([part[name] for part in parts]) for name in parts[0]}
    if isinstance(parts[0], tuple):
        return tuple(map(_joined, zip(*parts, strict=True)))
    return np.concatenate(parts)


def beside(*videos: np.ndarray, captions: Sequence[Caption], gap: int = 12) -> np.ndarray:
    """Join videos side by side with captions; shorter ones hold their last frame.

    Captions are above the videos, because players put their controls at the bottom.

    Args:
        videos: Each [T, H, W, 3] uint8, of any length and size.
        captions: For each video a text, or a function from frame number to text.
        gap: Pixels between the videos and around them.

    Returns:
        [T, H, W, 3] uint8, with T of the longest video.

    Raises:
        ValueError: If there is not one caption for each video.
    """
    if not videos or len(videos) != len(captions):
        raise ValueError(f"{len(videos)} videos and {len(captions)} captions; one for each")
    texts = [
        [_wrapped(one(k) if callable(one) else one, video.shape[2]) for k in range(len(video))]
        for one, video in zip(captions, videos, strict=True)
    ]
    lines = max(len(text) for column in texts for text in column)
    frames, tallest = max(len(video) for video in videos), max(v.shape[1] for v in videos)
    width = gap + sum(video.shape[2] + gap for video in videos)
    strip = gap // 2 + lines * LINE
    top = strip + gap // 4
    canvas = np.full((frames, top + tallest + gap, width, 3), BACKGROUND, np.uint8)
    left = gap
    for video, column in zip(videos, texts, strict=True):
        here = slice(left, left + video.shape[2])
        held = np.minimum(np.arange(frames), len(video) - 1)
        canvas[:, top : top + video.shape[1], here] = video[held]
        strips = {text: _strip(text, video.shape[2], strip) for text in set(column)}
        canvas[:, :strip, here] = [strips[column[k]] for k in held]
        left += video.shape[2] + gap
    return canvas


@functools.cache
def _wrapped(text: str, width: int) -> tuple[str, ...]:
    """Break `text` between words into lines of at most `width` pixels."""
    font = ImageFont.load_default(CAPTION)
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return tuple(lines)


def _strip(lines: Sequence[str], width: int, height: int) -> np.ndarray:
    """Draw text, [height, width, 3] uint8."""
    image = Image.new("RGB", (width, height), BACKGROUND)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(CAPTION)
    first = height - len(lines) * LINE  # the last line lies on the video
    for k, line in enumerate(lines):  # at the left, so that numbers that change do not shake it
        draw.text((0, first + (k + 0.5) * LINE), line, INK, font, anchor="lm")
    return np.array(image)


def write(frames: np.ndarray, path: Path, fps: int = FPS) -> None:
    """Write frames [T, H, W, 3] uint8 as an .mp4 file, and a .gif beside it."""
    write_mp4(frames, path, fps)
    write_gif(frames, path.with_suffix(".gif"), fps)


def write_mp4(frames: np.ndarray, path: Path, fps: int = FPS) -> None:
    """Write `frames` [T, H, W, 3] uint8 as a video that browsers play; `path` ends in .mp4.

    Raises:
        ValueError: If `frames` or `fps` is invalid.
        OSError: If the file cannot be written.
    """
    _check(frames, fps)
    odd = [(0, 0), *((0, size % 2) for size in frames.shape[1:3]), (0, 0)]
    even = np.pad(frames, odd, mode="edge")  # yuv420p halves both sides
    codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        container.metadata["comment"] = SIGN
        stream = container.add_stream(codec, rate=fps, options={"crf": "20"})
        stream.height, stream.width = even.shape[1:3]
        stream.pix_fmt = "yuv420p"
        for frame in even:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    write_aside(path, file.getvalue())


def write_gif(frames: np.ndarray, path: Path, fps: int = FPS) -> None:
    """Write `frames` [T, H, W, 3] uint8 as a looping GIF with a single palette.

    Raises:
        ValueError: If `frames` or `fps` is invalid.
        OSError: If the file cannot be written.
    """
    _check(frames, fps)
    # The palette comes from up to 16 frames, spread over the video.
    few = frames[np.unique(np.linspace(0, len(frames) - 1, 16).astype(int))]
    palette = Image.fromarray(few.reshape(-1, *few.shape[2:])).quantize(
        255, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
    )  # 255: one is left for "as before"
    images = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    ends = [round(100 * k / fps) for k in range(len(frames) + 1)]  # GIFs count hundredths of a s
    milliseconds = [10 * int(n) for n in np.diff(ends)]
    file = io.BytesIO()
    how: Any = {"duration": milliseconds, "loop": 0, "comment": SIGN}
    images[0].save(file, "GIF", save_all=True, append_images=images[1:], **how)
    write_aside(path, file.getvalue())


def _check(frames: np.ndarray, fps: int) -> None:
    of_kind("frames", frames, np.ndarray)
    bounded("fps", fps, 1, FASTEST)
    if frames.ndim != 4 or frames.shape[3] != 3 or frames.dtype != np.uint8 or not frames.size:
        raise ValueError(f"a video is [T, H, W, 3] uint8, not {frames.shape} {frames.dtype}")
