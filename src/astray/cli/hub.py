"""Verbs for the Hugging Face Hub: push an agent of yours, pull somebody's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


def push(
    run: Positional[Path],
    repository: Positional[str],
    shift: str | None = None,
    revision: str | None = None,
    private: bool = False,
) -> None:
    """Upload an agent to the Hugging Face Hub, with a card that tells what it pursues.

    The token is huggingface_hub's: hf auth login, or HF_TOKEN.

    Args:
        run: a run folder or a checkpoint in it, or the name of a kept agent
        repository: USER/NAME; it is made where there is none
        shift: which goals are intended and proxies; by default the one that the run trained for
        revision: a branch, which is made where there is none; by default the main one
        private: if the repository is made, let nobody else see it
    """
    from astray.experiments.hub import push as upload

    commit = upload(run, repository, shift=shift, revision=revision, private=private)
    print(f"{commit.address} at {commit.revision}")


def pull(
    repository: Positional[str],
    name: Annotated[str | None, arg(name="as")] = None,
    revision: str | None = None,
    offline: bool = False,
) -> None:
    """Download an agent from the Hugging Face Hub and check it. Nothing of it is run.

    Args:
        repository: USER/NAME
        name: by which every verb finds it; by default the repository's
        revision: a branch, a tag or a commit; by default the main branch
        offline: take it from the cache of what was downloaded before
    """
    from astray.experiments.hub import pull as download

    print(download(repository, name=name, revision=revision, offline=offline))
