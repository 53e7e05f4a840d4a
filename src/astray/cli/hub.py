"""Verbs for the Hugging Face Hub: push an agent of yours, pull somebody's."""

from typing import Annotated

from tyro.conf import Positional, arg

from astray.cli.arguments import Agent, Shift
from astray.training.settings import otherwise


def push(
    agent: Agent,
    repository: Positional[str],
    shift: Shift = None,
    revision: Annotated[str | None, otherwise("the main branch")] = None,
    private: bool = False,
) -> None:
    """Upload an agent to the Hugging Face Hub, with a card about its goals.

    Log in with `hf auth login` first, or set HF_TOKEN.

    Example: astray push runs/mice/seed-0 ada/corner-mouse --private

    Args:
        repository: Repository as USER/NAME, created if needed.
        revision: Branch, created if needed.
        private: Make the repository private if it is created.
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
            help="Name that other verbs find the agent by.",
            help_behavior_hint="(default: the repository's)",
        ),
    ] = None,
    revision: Annotated[str | None, otherwise("the main branch")] = None,
    offline: bool = False,
) -> None:
    """Download an agent from the Hugging Face Hub and check it. No code in it is run.

    Example: astray pull ada/corner-mouse --as ada-mouse

    Args:
        repository: Repository as USER/NAME.
        revision: Branch, tag or commit.
        offline: Use only files that were downloaded before.
    """
    from astray.experiments.hub import pull as download

    print(download(repository, name=name, revision=revision, offline=offline))
