"""Sending agents elsewhere, with a network that was made to follow the cheese."""

import pytest
import torch
from torch import nn

from astray import games, load_agent
from astray.acting import initial_states
from astray.agents.policy import Architecture
from astray.insight.fields import fields
from astray.insight.retarget import AS_IS, CLAMPED, MOVED, WAYS, Clamp, following, retarget
from astray.level import Level
from astray.training import folders
from helpers.looked_into import make_agent

MAZE = games.find("maze")
SMALL = MAZE.variant("anywhere-small")
NUMBERS = range(200_000, 200_008)


class Seeker(nn.Module):
    """Steps in the direction of the cheese, and looks through `eye`: channel 1 has the cheese."""

    def __init__(self):
        super().__init__()
        self.eye = nn.Identity()

    def forward(self, planes):
        x = planes.float()
        seen = self.eye(torch.stack([x[:, 0], x[:, 2], x[:, 1] * 0.5], 1))
        rows, columns = torch.meshgrid(torch.arange(7.0), torch.arange(7.0), indexing="ij")
        at = [
            (seen[:, 1] * c).sum((1, 2)) / seen[:, 1].sum((1, 2)).clamp(min=1e-6)
            for c in (columns, rows)
        ]
        mouse = [(x[:, 1] * c).sum((1, 2)) for c in (columns, rows)]
        logits = torch.zeros(len(x), 15)
        for k, (low, high) in enumerate(((1, 7), (3, 5))):  # left, right; down, up
            gap = at[k] - mouse[k]
            logits[:, high] += 3 * (gap > 0.5).float()
            logits[:, low] += 3 * (gap < -0.5).float()
        return logits, seen[:, 1].sum((1, 2))


@pytest.fixture
def seeker(tmp_path):
    agent = make_agent("small", tmp_path)
    agent.network = Seeker()
    agent.architecture = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15)
    return agent


def test_the_channel_that_has_the_cheese_is_found(seeker):
    found = following(seeker, SMALL, NUMBERS, "eye")
    first = found.row(0, named=True)
    assert first["channel"] == 1 and first["correlation"] == pytest.approx(1)
    assert first["there"] == 1 and first["elsewhere"] == 0
    assert abs(found["correlation"][1:].to_numpy()).max() < 1e-6, "walls and mouse stay"


def test_the_right_place_is_set_in_symbols_whose_rows_go_up(seeker):
    """Symbolic planes have the lowest row first, images the highest."""
    level = Level.of(MAZE, SMALL, initial_states("maze", SMALL, [200_003])[0])
    rows = retarget(seeker, SMALL, {"one": level}, Clamp("eye", (1,), (50.0,)), targets=40)
    moved = rows.filter(how=MOVED).sort("x", "y")
    clamped = rows.filter(how=CLAMPED).sort("x", "y")
    plain = rows.filter(how=AS_IS).sort("x", "y")
    assert moved["path"].mean() > plain["path"].mean() + 0.02
    assert abs(clamped["path"] - moved["path"]).mean() < abs(plain["path"] - moved["path"]).mean()


def test_paths_are_those_of_fields():
    mouse = load_agent(folders.find("maze-corner"))
    level = Level.of(MAZE, SMALL, initial_states("maze", SMALL, [200_003])[0])
    rows = retarget(mouse, SMALL, {"one": level}, Clamp("spread", (0,), (0.0,)), targets=50)
    (plain,) = fields(mouse, SMALL, {"one": level})
    ways = plain.path_probability()
    for row in rows.filter(how=AS_IS).to_dicts():
        assert row["path"] == pytest.approx(ways[row["x"], row["y"]])
    one = rows.filter(how=MOVED).row(0, named=True)
    moved = level.moved("goal", (one["x"], one["y"]))
    (field,) = fields(mouse, SMALL, {"one": moved})
    assert one["path"] == pytest.approx(field.path_probability()[one["x"], one["y"]])
    assert rows["how"].unique().sort().to_list() == sorted(WAYS)


def test_what_no_clamp_can_be_is_told(seeker):
    with pytest.raises(ValueError, match="a value for each channel, at least one; got 2 chan"):
        Clamp("eye", (1, 2), (1.0,))
    mouse = load_agent(folders.find("maze-corner"))
    with pytest.raises(ValueError, match="has no places"):
        following(mouse, SMALL, NUMBERS, "features.relu1")
    assert following(mouse, SMALL, NUMBERS, "spread")["correlation"].is_finite().all()
