"""Run folders of older versions are read."""

import json
from dataclasses import replace

import pytest

from astray.training.config import Config
from helpers.trainings import TINY


def test_a_knob_that_came_later_was_as_it_is_by_default():
    mixed = replace(TINY, knobs=TINY.knobs | {"shift_probability": 0.1}, validation=None)
    data = json.loads(json.dumps(mixed.to_json()))
    for variant in (data["training_variant"], data["training_variant"]["shifted"]):
        del variant["dish_planes"]
    assert Config.from_json(data) == mixed
    with pytest.raises(ValueError, match="no setting 'environment'"):
        Config.from_json(data | {"environment": 3})
    data["training_variant"]["shifted"]["window"] = 3
    with pytest.raises(ValueError, match="its maze corner-small is not that of this version"):
        Config.from_json(data)
