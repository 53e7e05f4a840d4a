"""The settings of a training with their types, those of its records beside the others."""

import typing

from astray.training.config import RECORDS, Config


def kinds():
    found = {}
    for name, kind in typing.get_type_hints(Config).items():
        if name in RECORDS:
            hints = typing.get_type_hints(RECORDS[name])
            found |= {name if own == "kind" else own: hint for own, hint in hints.items()}
        else:
            found[name] = kind
    return found
