"""Print the oldest version of each library that pyproject.toml admits, as constraints for pip."""

import re
import tomllib
from pathlib import Path

PROJECT = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text())["project"]


def main() -> None:
    extras = PROJECT["optional-dependencies"].values()
    for needed in sorted({*PROJECT["dependencies"], *(one for each in extras for one in each)}):
        if ">=" in needed:  # all but astray's own extras
            print(re.sub(r"\[.*\]", "", needed).replace(">=", "=="))


if __name__ == "__main__":
    main()
