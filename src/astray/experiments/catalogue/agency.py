"""Agents and devices: can goal-directed failure be told from plain failure?"""

from __future__ import annotations

from pathlib import Path

from astray.experiments.spec import Size, Study


def _tell(study: Study, name: str, size: Size, folder: Path) -> Path:
    from astray.experiments.agency import tell  # matplotlib, two seconds

    return tell(study, name, size, folder)


EXPERIMENT = Study(
    title="Agents and devices",
    reproduces="Table 1 and the figure beside it",
    question="Does the measure tell goal misgeneralization from capability failure?",
    sizes={"smoke": 200, "paper": 2000},  # trajectories of each type on each map
    tell=_tell,
)
