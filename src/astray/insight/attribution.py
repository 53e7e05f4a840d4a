"""Attribution of the critic's value to parts of the observation.

    maps = gradients(agent, observe(agent, variant, states))
    where = masks(agent, variant, states, edits.PARTS)
    group_means(fractions(rows, maps, where), "attribution", ["part"], per="area")

A map is [N, H, W] for images, the mean over colours as in the paper, and [N, C, H, W] for symbolic
planes; for a `Network` it has the shape of its inputs. An agent with memory is asked as at the
beginning of an episode. The methods are Captum's, of the extra `insight`. `critic.counterfactual`
measures the effect of a whole part.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import polars as pl
import torch
from torch import Tensor

from astray import imports
from astray.agents.mlp import MLP
from astray.analysis.critic import Edit, observe
from astray.analysis.trained import Agent, Model, Network, check_network
from astray.envs.vector import IMAGE
from astray.game import Variant
from astray.validation import MOST, bounded, of_kind

CHUNK = 64  # observations at a time
REST, NOTHING = "rest", "nothing"  # parts that are what no other is


def gradients(agent: Model, observations: np.ndarray) -> np.ndarray:
    """Return the gradient of the value at observations [N, ...] (Simonyan et al. 2013).

    It is float64. For images it is per unit of brightness from 0 to 1, for binary planes per unit.
    For planes of categories it is per unit of the present category, and 0 if there is none.

    Raises:
        ImportError: If captum is not installed.
        ValueError: If the observations do not fit the agent, or planes are for another network.
    """
    _check(agent, observations)
    method = _captum().Saliency(_value(agent))

    def attribute(x: Tensor) -> Tensor:
        gradient = method.attribute(x.requires_grad_(), abs=False)
        if _is_planes(agent):
            flags = _mlp(agent).spread.flags
            gradient[:, flags:] *= x.detach()[:, flags:]
        return gradient

    return _maps(agent, attribute, observations)


def integrated_gradients(
    agent: Model, observations: np.ndarray, baseline: np.ndarray | None = None, *, steps: int = 64
) -> np.ndarray:
    """Return integrated gradients of `observations` [N, ...] (Sundararajan et al. 2017), [N, ...].

    A map sums to the value's difference from the baseline, the more exactly the more `steps`; for
    images to a third of that, because it is the mean over three colours.

    Args:
        baseline: [...] or [N, ...]: one observation or one for each, such as states without the
            coin; None for black images or empty planes.

    Raises:
        ImportError: If captum is not installed.
        ValueError: If the baseline has another shape, or `steps` is out of range.
    """
    _check(agent, observations)
    bounded("steps", steps, 1, MOST)
    baseline = np.zeros_like(observations) if baseline is None else baseline
    of_kind("baseline", baseline, np.ndarray)
    method = _captum().IntegratedGradients(_value(agent))

    def attribute(x: Tensor, before: Tensor) -> Tensor:
        return method.attribute(x, before, n_steps=steps, internal_batch_size=4 * CHUNK)

    return _maps(agent, attribute, observations, np.broadcast_to(baseline, observations.shape))


def occlusion(
    agent: Model, observations: np.ndarray, *, window: int = 4, colour: int = 0
) -> np.ndarray:
    """Return the fall of the value if a part of `observations` [N, ...] is covered, [N, ...].

    Images are covered square by square (Zeiler & Fergus 2014). In planes, one cell of one plane at
    a time becomes 0.

    Args:
        window: Side of a square in pixels, for images; 4 are most of a cell of CoinRun.
        colour: Brightness of the squares, from 0 (black) to 255.

    Raises:
        ImportError: If captum is not installed.
        ValueError: If an argument is out of its range.
    """
    _check(agent, observations)
    bounded("window", window, 1, IMAGE)
    bounded("colour", colour, 0, 255)
    image = _is_image(agent)
    shape = (window, window, observations.shape[3]) if image else (1,) * (observations.ndim - 1)
    method = _captum().Occlusion(lambda x: agent.asked(x)[1])
    maps = []
    for x in torch.from_numpy(observations).split(CHUNK):
        fallen = method.attribute(
            x.float().to(agent.device),
            shape,
            strides=shape,
            baselines=colour if image else 0,
            perturbations_per_eval=max(1, CHUNK // len(x)),
        )
        maps.append(fallen.double().numpy(force=True))
    return np.concatenate(maps).mean(3) if image else np.concatenate(maps)


def masks(
    agent: Model, variant: str | Variant, states: np.ndarray, parts: Mapping[str, Edit]
) -> dict[str, np.ndarray]:
    """Return boolean masks of each part in `states` [N], with the shape of maps, and REST.

    In planes only cells with contents belong to these; all cells of 0 are NOTHING, which gets much
    gradient but no other attribution.

    Args:
        parts: Edits that each remove a part (or change the look of an indispensable one). The part
            is where the observation then differs. Pixels of several parts, such as a coin's soft
            edge, belong to the first.
    """
    shown = observe(agent, variant, states)
    if agent.observation == "image":
        colours, where, left = 3, {}, np.ones(shown.shape[:3], bool)
    else:
        colours, where, left = (), {NOTHING: shown == 0}, shown != 0
    for name, edit in parts.items():
        differs = (observe(agent, variant, edit(states.copy())) != shown).any(colours)
        where[name] = differs & left
        left &= ~differs
    return where | {REST: left}


def fractions(
    rows: pl.DataFrame, maps: np.ndarray, where: Mapping[str, np.ndarray]
) -> pl.DataFrame:
    """Return `rows` [N] once for each part, with the fraction of each map on it.

    New columns: part; attribution, the part's fraction of the sum of absolute values (null if all
    are 0); area, its fraction of pixels or plane cells. Their ratio is 1 for a part that matters
    no more than its size. ValueError is raised unless rows, maps and masks have the same length.
    """
    size, found = maps[0].size, []
    absolute = abs(maps).reshape(len(maps), size)
    total = absolute.sum(1)
    for part, mask in where.items():
        if mask.shape != maps.shape or len(rows) != len(maps):
            raise ValueError(
                f"{len(rows)} rows, maps {maps.shape} and a mask {mask.shape} do not go together"
            )
        flat = mask.reshape(len(maps), size)
        unknown = np.full(len(maps), np.nan)
        fraction = np.divide((absolute * flat).sum(1), total, where=total > 0, out=unknown)
        told = {"part": [part] * len(maps), "attribution": fraction, "area": flat.mean(1)}
        found.append(rows.hstack(pl.DataFrame(told)))
    return pl.concat(found).with_columns(pl.col("attribution").fill_nan(None))


def _captum() -> Any:
    with imports.extra("insight", "attribution needs captum"):
        import captum.attr
    return captum.attr


def _is_image(agent: Model) -> bool:
    """Return whether the agent sees astray's images; other maps follow the inputs."""
    return isinstance(agent, Agent) and agent.observation == "image"


def _is_planes(agent: Model) -> bool:
    return isinstance(agent, Agent) and bool(agent.architecture.largest)


def _mlp(agent: Model) -> MLP:
    network: Any = agent.network
    of_kind("the network for gradients of planes (occlusion takes any)", network, MLP)
    return network


def _value(agent: Model) -> Callable[[Tensor], Tensor]:
    """Return the differentiable value [N] as a function of the result of `_inputs`."""
    if not _is_planes(agent):
        return lambda x: agent.asked(255 * x if _is_image(agent) else x)[1]
    network = _mlp(agent)
    return lambda x: network.value(network.features(x)).squeeze(-1)


def _inputs(agent: Model, observations: np.ndarray) -> Tensor:
    """Return the differentiable inputs: images from 0 to 1, or planes as the mlp embeds them."""
    x = torch.from_numpy(observations.copy()).to(agent.device)
    if _is_planes(agent):
        return _mlp(agent).spread(x)
    return x.float() / 255 if _is_image(agent) else x.float()


def _maps(agent: Model, attribute: Callable[..., Tensor], *observations: np.ndarray) -> np.ndarray:
    """Apply `attribute` to the inputs in chunks and return maps."""
    found = []
    for first in range(0, len(observations[0]), CHUNK):
        chunk = [_inputs(agent, some[first : first + CHUNK]) for some in observations]
        found.append(attribute(*chunk).detach().double().numpy(force=True))
    maps = np.concatenate(found)
    if not _is_planes(agent):
        return maps.mean(3) if _is_image(agent) else maps
    flags = _mlp(agent).spread.flags  # then two planes for each plane of categories
    one, other = np.split(maps[:, flags:], 2, axis=1)
    return np.concatenate([maps[:, :flags], one + other], axis=1)


def _check(agent: Model, observations: np.ndarray) -> None:
    check_network(agent)
    of_kind("observations", observations, np.ndarray)
    shape = agent.space.shape
    if observations.shape[1:] != shape or not len(observations):
        raise ValueError(
            f"the agent sees observations [N, {', '.join(map(str, shape))}], "
            f"not {observations.shape}"
        )
    if isinstance(agent, Network) and agent.outputs(observations[:1])[1].isnan().any():
        raise ValueError(f"attribution needs values; {agent.name} returns none")
