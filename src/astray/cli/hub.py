"""Verbs for the Hugging Face Hub: push an agent of yours, pull somebody's."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import Positional, arg

from astray.cli.arguments import Agent, Shift
from astray.training.settings import otherwise


def push(
    agent: Agent,
    repository: Positional[str],
    shift: Shift = None,
    revision: Annotated[str | None, otherwise("the main one")] = None,
    private: bool = False,
) -> None:
    """Upload an agent to the Hugging Face Hub, with a card about its goals.

    The token is huggingface_hub's: hf auth login, or HF_TOKEN.

    Example: astray push runs/mice/seed-0 ada/corner-mouse --private

    Args:
        repository: Repository, as USER/NAME; it is made where there is none.
        revision: Branch, which is made where there is none.
        private: Let nobody else see the repository, if it is made.
    """
    from astray.experiments.hub import push as upload

    commit = upload(agent, repository, shift=shift, revision=revision, private=private)
    print(f"{commit.address} at {commit.revision}")


def pull(
    repository: Positional[str],
    name: Annotated[
        str | None,
        arg(
            name="as",
            help="Name by which every verb finds it.",
            help_behavior_hint="(default: the repository's)",
        ),
    ] = None,
    revision: Annotated[str | None, otherwise("the main branch")] = None,
    offline: bool = False,
) -> None:
    """Download an agent from the Hugging Face Hub and check it. Nothing of it is run.

    Example: astray pull ada/corner-mouse --as ada-mouse

    Args:
        repository: Repository, as USER/NAME.
        revision: Branch, tag or commit.
        offline: Take it from the cache of what was downloaded before.
    """
    from astray.experiments.hub import pull as download

    print(download(repository, name=name, revision=revision, offline=offline))
