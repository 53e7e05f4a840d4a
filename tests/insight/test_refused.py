"""What functions of insight cannot take is told, with what it is."""

import numpy as np
import polars as pl
import pytest

from astray.acting import initial_states
from astray.analysis.critic import counterfactual, observe
from astray.analysis.dataset import export, read_trajectories
from astray.analysis.outcomes import rates
from astray.analysis.runs import open_run
from astray.envs.states import load_states
from astray.games import find
from astray.insight import attribution
from astray.insight.activations import capture, layers
from astray.insight.cell_probes import ahead
from astray.insight.episode import along
from astray.insight.fields import difference, fields
from astray.insight.interventions import patch, steer
from astray.insight.probes import probe
from astray.insight.retarget import Clamp, retarget
from astray.insight.vectors import Condition, Vectors, edit_vectors, effects, pair_vectors
from astray.mitigation.uncertainty import margin, max_logit
from helpers.looked_into import make_agent

MAZE = find("maze")
LEVEL = initial_states(MAZE, "corner-small", [1])
SEEN = np.zeros((1, 4, 7, 7), np.uint8)
ONE = Condition([Vectors("spread", np.zeros((1, 6, 7, 7), np.float32))])
THIRD = LEVEL.copy()
THIRD["time"] = 2
MANY = initial_states(MAZE, "corner-small", range(1, 7))


def _wall(state):
    return 99, 0


def _named(states):
    return np.where(states["level"] % 2, "odd", "even")


@pytest.fixture
def agent(tmp_path):
    return make_agent("small", tmp_path)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda a: observe(None, "corner-small", np.zeros(1)), "agent must be a Agent"),
        (lambda a: observe(a, "corner-small", [1]), "states must be a ndarray"),
        (lambda a: capture(a, "corner-small", np.zeros(3), ["spread"]), "records of maze"),
        (lambda a: counterfactual(a, "corner-small", LEVEL, "x"), "edit must be a function"),
        (lambda a: capture(a, "corner-small", LEVEL, [["spread"]]), "unknown layer .*spread"),
        (lambda a: layers(None), "agent must be a Agent"),
        (lambda a: pair_vectors(a, "corner-small", "spread", None, None), "states must be a nda"),
        (lambda a: rates(pl.DataFrame({"seed": [0]})), "episodes must have the columns policy"),
        (lambda a: open_run(None), "an agent must be the path of a file or folder; got N"),
        (lambda a: list(read_trajectories(None)), "folder must be the path of a file or"),
        (lambda a: load_states(None, "maze"), "the path of a file must be a str or Path"),
        (lambda a: max_logit(None), "logits must be a ndarray"),
        (lambda a: margin(np.full((2, 3), np.nan)), "the largest logit of each row must be finite"),
        (lambda a: margin(np.zeros(())), "logits must be .N, A. numbers"),
        (lambda a: attribution.gradients(a, None), "observations must be a ndarray"),
        (lambda a: attribution.occlusion(a, SEEN, window=0), "window must be an integer from 1"),
        (lambda a: attribution.integrated_gradients(a, SEEN, steps=0), "steps must be an integer"),
        (lambda a: a.outputs(np.zeros((1, 4, 7, 7))), "sees integers from 0 to 255, not float64"),
        (lambda a: along(a, "corner-small", 3, gamma=2.0), "gamma must be a finite number from 0"),
        (lambda a: difference(None, None), "a field must be a Field"),
        (lambda a: retarget(a, "corner-small", [1], 5), "clamp must be a Clamp"),
        (lambda a: Clamp("spread", 1, 2.0), "channels must be a Sequence"),
        (lambda a: Condition(vectors="x"), "each of the vectors must be a Vectors"),
        (
            lambda a: effects(a, "corner-small", [1, 2], "cheese", {"one": ONE}),
            "of 2 levels; got 1",
        ),
        (
            lambda a: effects(a, "corner-small", [1], "cheese", {"a": Condition()}, at=_wall),
            r"at must return a place of the agent in level 0; got \(99, 0\)",
        ),
        (
            lambda a: probe(a, "corner-small", MANY, ["spread"], {"a": _named}),
            "integers or booleans, for classes, or reals; got 'odd'",
        ),
        (lambda a: ahead(THIRD, 7), "states must be those of whole episodes"),
        (lambda a: Condition(coefficient=np.nan), "coefficient must be a finite number"),
        (lambda a: edit_vectors(a, "corner-small", [1], "spread", 5), "must be a function of lev"),
        (lambda a: fields(a, "corner-small", {"a": 5}), "a level by name must be a Level; got 5"),
        (lambda a: probe(a, "corner-small", LEVEL, ["spread"], None), "labels must be a Mapping"),
        (lambda a: steer(a, {"spread": np.ones(7, complex)}), "must be real numbers that go with"),
        (lambda a: steer(a, {"spread": ["1"] * 7}), "must be real numbers that go with"),
        (lambda a: patch(a, "spread", [1], 1j), "value must be real numbers that go with"),
        (lambda a: export(b"x", "maze", "corner-small", [1], None), "a policy must have name"),
    ],
)
def test_what_is_of_another_kind_is_told(agent, make, message):
    with pytest.raises(ValueError, match=message):
        make(agent)


def test_a_place_that_is_none_is_told(agent):
    (field,) = fields(agent, "corner-small", [3])
    asked = [
        lambda: field.towards("ab"),
        lambda: field.step([], (1, 1)),
        lambda: field.path_probability((0.5, 1)),
        lambda: field.places.way({}),
    ]
    for ask in asked:
        with pytest.raises(ValueError, match="a cell must be two integers, x and y"):
            ask()
