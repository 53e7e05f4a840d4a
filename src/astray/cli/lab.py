"""The verb that opens the lab or exports it."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional

from astray.cli.arguments import AN_AGENT, Acting, GivenLevel, OwnPolicy
from astray.files import check_empty, check_writable
from astray.training.settings import otherwise
from astray.validation import bounded

LARGEST_PORT = 2**16 - 1
EXPORTED, MOST = 50, 10_000  # levels of a variant that are exported: by default, and at most


def lab(
    agent: Positional[Annotated[Path | None, otherwise("maze-corner", AN_AGENT)]] = None,
    policy: OwnPolicy = OwnPolicy(),
    variant: Annotated[str | None, otherwise("the variant that the agent is tested on")] = None,
    level: GivenLevel = GivenLevel(),
    port: Annotated[int | None, otherwise("any free one")] = None,
    browser: bool = True,
    export: Annotated[Path | None, otherwise("none")] = None,
    num_levels: Annotated[int | None, otherwise(f"{EXPORTED}")] = None,
) -> None:
    """Open a page to edit levels and see any policy's actions and values everywhere.

    With --game alone it shows a game's levels without an agent. For a policy without a network,
    arrows show the actions that it takes, and there are no values.

    Example: astray lab maze-corner --variant anywhere-small --level 17

    Args:
        variant: Variant that levels are drawn from.
        port: Port, reachable from this machine only.
        browser: Open the page in the browser.
        export: Folder for a copy of the page and the agents that any web server can serve.
        num_levels: Number of levels of each variant to export.

    Raises:
        ValueError: If options do not go together.
    """
    from astray.lab.serving import make_lab

    bounded("port", port or 0, 0, LARGEST_PORT)
    bounded("num_levels", exported := EXPORTED if num_levels is None else num_levels, 1, MOST)
    if num_levels is not None and export is None:
        raise ValueError("--num-levels says how many are exported: it needs --export FOLDER")
    if port is not None and export is not None:
        raise ValueError("--export writes files and opens no --port; give one of them")
    if export is not None and (level.level or 0) >= exported:
        raise ValueError(f"levels 0 to {exported - 1} are exported; --num-levels says how many")
    if policy.policy is None and policy.observation is not None:
        raise ValueError(f"--observation {policy.observation} needs --policy; agents have theirs")
    level.check()
    policy.check_game("lab")
    shown: Any = agent
    if policy.policy is not None:
        if export is not None:
            raise ValueError("--export writes agents of run folders; a policy needs Python to act")
        shown, rules, _ = policy.open(agent, Acting(), needs={})
        policy = replace(policy, game=rules.name)
    start: Any = {"game": policy.game, "variant": variant, "level": level.level_file or level.level}
    if export is not None:
        from astray.lab.export import check_exportable
        from astray.lab.export import export as write

        check_empty(export)
        check_writable(export / "index.html")
        found = make_lab(shown, start | {"level": 0})  # before a level is looked for
        check_exportable(found, None, {})
        write(make_lab(shown, start, exported), export, exported)
        print(f"{export / 'index.html'}")
        return
    from astray.lab.server import serve

    serve(make_lab(shown, start), port or 0, browser)
