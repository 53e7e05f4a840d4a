"""The catalogue: every file in a folder of `studies` is one figure or table, without a list.

Files that begin with an underscore are shared by the studies beside them. Studies of your own live
in other modules or files; `find` accepts them too.
"""

import importlib
import importlib.util
import os
import re
import sys
import traceback
from pathlib import Path

from astray import imports
from astray.experiments import studies
from astray.experiments.spec import Experiment
from astray.files import check_readable
from astray.validation import brief, of_kind, one_of, slug

LARGEST = 2**20  # bytes of a file of Python
MODULES = {  # of studies, by their names
    path.stem.replace("_", "-"): f"{studies.__name__}.{path.parent.name}.{path.stem}"
    for path in sorted(Path(*studies.__path__).glob("*/[!_]*.py"))
}
NAMES = tuple(sorted(MODULES))


def load(name: str) -> Experiment:
    """Return the experiment called `name`; raise ValueError if there is none."""
    one_of("experiment", name, NAMES)
    return importlib.import_module(MODULES[name]).EXPERIMENT


def title(name: str) -> str:
    """Return the title of an experiment in its file, which takes seconds to import."""
    file = Path(*studies.__path__, *MODULES[name].split(".")[-2:]).with_suffix(".py")
    return re.findall(r'(?m)^EXPERIMENT = [^"]+"(.+?)"', file.read_text("utf-8"))[0]


def find(experiment: str | Experiment) -> tuple[str, Experiment]:
    """Return an experiment and the name of its report.

    Args:
        experiment: Name in the catalogue; or your own: an object, "module:OBJECT", or the path of
            a Python file that defines EXPERIMENT, which is run.

    Raises:
        ValueError: If there is none.
    """
    of_kind("experiment", experiment, str | Experiment)
    if isinstance(experiment, Experiment):
        return experiment.name or slug(experiment.title), experiment
    if imports.is_name(experiment):
        module, _, its = experiment.partition(":")  # its own name, too: a module may have several
        name = f"{module.rpartition('.')[2]} {its}".removesuffix(" EXPERIMENT")
        study = imports.find(experiment)
        for other, twin in vars(sys.modules[module]).items():  # names may differ in case alone
            are_two = twin is not study and slug(other) == slug(its)
            if are_two and all(isinstance(x, Experiment) and not x.name for x in (twin, study)):
                told = f"would share the report {slug(name)!r}; give one of them a name"
                raise ValueError(f"{its} and {other} of {module} {told}")
    elif experiment.endswith(".py"):
        name, study = Path(experiment).stem, _run(Path(experiment))
    else:
        return experiment, load(experiment)
    if not isinstance(study, Experiment):
        raise ValueError(f"{experiment} must be an Experiment; got {study!r}")
    return study.name or slug(name), study


def origin(experiment: str | Experiment, folder: Path) -> str | None:
    """Return the file of an experiment that `find` found, seen from a folder, or its name.

    It is None for an object. A report that is given away tells no path of its author's.
    """
    if isinstance(experiment, Experiment) or experiment in NAMES:
        return experiment if isinstance(experiment, str) else None
    file: str | None = experiment
    if imports.is_name(experiment):
        file = getattr(sys.modules[experiment.partition(":")[0]], "__file__", None)
    try:
        return file and os.path.relpath(os.path.realpath(file), os.path.realpath(folder))
    except ValueError:  # it is on another drive of Windows
        return file and os.path.realpath(file)


def _run(path: Path) -> object:
    """Return the EXPERIMENT that a Python file defines."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"there is no experiment at {path}")
    check_readable(path, LARGEST)
    module = importlib.util.module_from_spec(spec)
    try:
        with imports.guarded(f"{path}", Exception):
            spec.loader.exec_module(module)
    except SyntaxError as error:
        raise ValueError(f"{path} must be a file of Python; {brief(error)}") from error
    except Exception as error:
        calls = traceback.extract_tb(error.__traceback__)
        lines = [call.lineno for call in calls if call.filename == str(path)]
        where = f"{path}, line {lines[-1]}" if lines else f"{path}"
        raise ValueError(f"{where}: {type(error).__name__}: {brief(error)}") from error
    if not hasattr(module, "EXPERIMENT"):
        raise ValueError(f"{path} must define EXPERIMENT")
    return module.EXPERIMENT
