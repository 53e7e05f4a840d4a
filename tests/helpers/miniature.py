"""Experiments in miniature."""

from dataclasses import replace


def miniature(plan, time_limit=100):
    """The plan with two agents of each name, trained for 2,048 steps in few short levels."""
    agents = {
        name: replace(
            config, levels=1000, steps=2048, environments=16, rollout=32, minibatches=4, width=16,
            checkpoint_every=1, knobs={**config.knobs, "time_limit": time_limit},
        )
        for name, config in plan.agents.items()
    }  # fmt: skip
    return replace(plan, agents=agents, seeds=2, levels=20)
