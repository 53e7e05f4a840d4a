"""Training on a Ray cluster whose nodes all see the run folders."""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from pathlib import Path

from astray import imports, world
from astray.experiments.spec import check_unedited
from astray.training import checkpoint
from astray.training.config import Config, Tracking
from astray.training.track import train_tracked
from astray.validation import brief
from astray.world import World

RETRIES = 20  # of a training whose node or process died; each goes on from its last checkpoint
PATIENCE = 300.0  # seconds: a file server may hold a dead node's lock for minutes
PAUSE = 5.0  # seconds between two looks at the lock

# Begins a training in a run folder, and tells a tracker of it.
Submit = Callable[[Config, Path, Tracking | None, Mapping[str, str]], Future[None]]


@contextlib.contextmanager
def on_ray() -> Iterator[Submit]:
    """Run trainings on the cluster, with processors and a GPU if needed; end all on exit.

    Raises:
        ConnectionError: If there is no cluster.
        ImportError: If Ray is not installed.
    """
    with imports.extra("cluster", "a Ray cluster needs ray"):
        import ray  # pyrefly: ignore
    try:
        ray.init(address="auto", log_to_driver=False)
    except ConnectionError:
        raise ConnectionError("no Ray cluster is running; `ray start --head` begins one") from None

    def submit(
        config: Config, run: Path, track: Tracking | None, known: Mapping[str, str]
    ) -> Future[None]:
        run.mkdir(parents=True, exist_ok=True)  # each node sees whether it is there
        task = ray.remote(train_on_node).options(
            name=str(run),
            num_cpus=config.threads,
            num_gpus=float(config.device == "cuda"),
            max_retries=RETRIES,
            retry_exceptions=[OSError],
        )
        game = config.find_game()  # a World is not known by its name elsewhere
        of = game if isinstance(game, World) else None
        return task.remote(config, run.resolve(), track, known, of).future()  # pyrefly: ignore

    try:
        yield submit
    except ray.exceptions.RayError as error:  # whose text is the node's traceback
        cause, *_, last = getattr(error, "cause", error), *str(error).strip().splitlines()
        if isinstance(cause, ray.exceptions.RayError):
            cause = RuntimeError(f"a node of the cluster fails: {brief(last)}")
        raise cause from error
    finally:
        ray.shutdown()  # and with it all that still trains


def train_on_node(
    config: Config,
    run: Path,
    track: Tracking | None,
    known: Mapping[str, str],
    of: World | None = None,
) -> None:
    """Train in `run` after the process before.

    Raises:
        ValueError: If the node does not see the folder, or has other modules of the user's.
    """
    if of is not None:
        world.register(of)
    if not run.is_dir():
        raise ValueError(f"{run} is not seen by every node; --out must be one that all nodes share")
    check_unedited(config, known)
    until = time.monotonic() + PATIENCE
    while True:
        try:
            train_tracked(config, run, track, progress=False)
            return
        except checkpoint.Claimed:
            if time.monotonic() > until:
                raise
        time.sleep(PAUSE)
