"""Agents and devices: can goal-directed failure be told from plain failure?"""

from astray.experiments.agency import find
from astray.experiments.spec import Experiment, Plan

EXPERIMENT = Experiment(
    title="Agents and devices",
    reproduces="Table 1 and the figure beside it",
    question="Does the measure tell goal misgeneralization from capability failure?",
    sizes={  # trajectories of each type on each map; the paper has one
        "smoke": Plan(levels=200, smaller=""),
        "paper": Plan(levels=2000, smaller=""),
    },
    find=find,
)
