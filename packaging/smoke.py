"""Try an installed astray: what a wheel must hold, and a training of some seconds; no test library.

python packaging/smoke.py          of an installation that trains
python packaging/smoke.py --core   of one for environments alone
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path


def astray(*words: str, folder: str) -> str:
    """What a command prints; the program ends where it fails."""
    done = subprocess.run(
        [sys.executable, "-m", "astray", *words], cwd=folder, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"astray {' '.join(words)} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def main() -> None:
    import gymnasium

    import astray as package

    home = Path(package.__file__).parent
    assert importlib.metadata.version("astray") == package.__version__
    assert not (Path(__file__).parents[1] / "src").is_relative_to(home.parent), "it is a checkout"
    for part in (
        "games/maze/art/cheese.png",
        "report/page.html",
        "experiments/card.md",
        "agents/pretrained/maze-corner/config.json",
        "published/catalogue.toml",
    ):
        assert (home / part).is_file(), f"the wheel lacks {part}"
    env = gymnasium.make_vec("astray/maze-anywhere-v0", num_envs=4, levels=range(100))
    images, _ = env.reset(seed=0)
    assert images.shape == (4, 64, 64, 3)
    env.step(env.action_space.sample())
    env.close()
    if "--core" in sys.argv:
        heavy = ("torch", "matplotlib", "polars", "scipy")
        there = [name for name in heavy if importlib.util.find_spec(name)]
        assert not there, f"environments alone bring {there}"
        return
    with tempfile.TemporaryDirectory() as folder:
        assert "maze-corner" in astray("list", folder=folder)
        assert "#######" in astray("level", "maze", "corner-small", "--levels", "7", folder=folder)
        trained = astray(
            "train", "maze", "corner-small", "--validation", "anywhere-small", "--steps", "8192",
            "--num-envs", "32", "--num-steps", "32", "--minibatches", "4", folder=folder,
        )  # fmt: skip
        assert (Path(folder) / trained.strip() / "agent.safetensors").is_file()
        assessed = astray("evaluate", "maze-corner", "--levels", "200000:200100", folder=folder)
        assert "intended goal" in assessed
        astray("record", "maze-corner", "--variant", "anywhere-small", folder=folder)
        assert (Path(folder) / "episode.mp4").stat().st_size > 1000
    print(f"astray {package.__version__} works on Python {sys.version.split()[0]}, {sys.platform}")


if __name__ == "__main__":
    main()
