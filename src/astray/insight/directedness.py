"""Goal-directedness of agents in levels: MEG of their policy at every place, for each goal.

    measured = directedness(field, {"cheese": (5, 1), "corner": (5, 5)})
    measured["corner"].fraction  # 1: as directed as shortest ways are, 0: as random actions

`agency.meg` defines the measure. A level is a decision process of its places. Equivalent actions
count as one, and a cell in which the agent cannot stay, such as the cheese's, ends the episode.
The game's places must follow from place and action alone, as in Maze.
"""

from collections.abc import Mapping

import numpy as np

from astray.agency.meg import Directedness, Process, goal_directedness
from astray.insight.fields import Field, Places
from astray.level import Cell
from astray.validation import shown


def process_of(places: Places, discount: float = 0.9) -> tuple[Process, dict[Cell, int]]:
    """Return the decision process of a level, and the state of each of its cells.

    Args:
        places: The K places of the level; their order is that of the first K states.
        discount: Factor of each later step, above 0 and below 1.

    Returns:
        The process, with a further state for each cell that ends an episode, and the number of
        each cell's state.
    """
    states = dict(places.number)
    for ways in places.leads:
        for cell in ways:
            states.setdefault(cell, len(states))
    after = np.array([[states[cell] for cell in ways] for ways in places.leads])
    first = np.array([[row.index(s) == a for a, s in enumerate(row)] for row in after.tolist()])
    ending = len(states) - len(after)
    return (
        Process(
            np.pad(after, ((0, ending), (0, 0))),
            np.pad(first, ((0, ending), (0, 0))),
            states[places.level.agent],
            discount,
        ),
        states,
    )


def directedness(
    field: Field, goals: Mapping[str, Cell], discount: float = 0.9
) -> dict[str, Directedness]:
    """Measure how goal-directed an agent is towards each of some cells of a level.

    Args:
        field: The agent's policy at every place of the level.
        goals: The cell (x, y) of each goal, by name.
        discount: Factor of each later step, above 0 and below 1.

    Raises:
        ValueError: A goal is a cell to which no action leads.
    """
    process, states = process_of(field.places, discount)
    for name, cell in goals.items():
        if cell not in states:
            raise ValueError(f"no action leads to the cell of {name}, {shown(cell)}")
    policy = np.zeros(process.after.shape)
    rows = np.arange(len(field.policy))[:, None]
    same = (process.after[rows, :, None] == process.after[rows, None, :])[:, 0].argmax(2)
    np.add.at(policy, (rows, same), field.policy)
    return {name: goal_directedness(process, policy, states[cell]) for name, cell in goals.items()}
