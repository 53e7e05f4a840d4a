"""Settings: their defaults, records, and the objects that are taken for names."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

import astray
from astray import games
from astray.analysis.runs import evaluate_policies
from astray.experiments import spec
from astray.game import Shift
from astray.training.config import PRESETS, Config, LeftOut
from astray.training.settings import Fast, Sampling
from helpers.rooms import WORLD

MAZE = games.find("maze")
CORNER, SMALL = MAZE.variants["corner"], MAZE.variants["anywhere-small"]
DAYS = 20_000_000  # steps that a CPU has done before a night is over, by any network of ours


def test_settings_that_nobody_chose_are_those_of_the_command_line_and_no_weeks_of_work():
    config = astray.Config(game="maze", variant="corner-small")
    assert config == replace(astray.PRESETS["small"], variant="corner-small")
    assert config.steps < DAYS and config.network == "mlp"
    assert astray.PRESETS["paper"].steps == 200_000_000


def test_a_file_that_lacks_a_setting_has_the_paper_s_as_older_versions_did():
    data = json.loads(json.dumps(PRESETS["paper"].to_json()))
    for name in ("observation", "network", "width", "steps", "gamma", "sampler", "groups"):
        del data[name]
    assert Config.from_json(data) == PRESETS["paper"]


def test_files_have_the_settings_of_records_beside_the_others():
    config = Config(sampler=Sampling("plr", buffer=512), fast=Fast(groups=4))
    data = json.loads(json.dumps(config.to_json()))
    assert (data["sampler"], data["buffer"], data["groups"]) == ("plr", 512, 4)
    assert Config.from_json(data) == config
    assert config.changed(sampler="accel", buffer=64).sampler == Sampling("accel", buffer=64)
    assert Config(sampler="plr").sampler == Sampling("plr")


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: Sampling(buffer=0), "buffer must be from 1 to"),
        (lambda: Fast(groups="two"), "groups must be of type int; got 'two'"),
        (lambda: Config(sampler="nearest"), "sampler must be one of uniform, mixed, growing, plr"),
        (lambda: Config(fast=3), "fast must be a Fast; got 3"),
        (lambda: Config().changed(squid=1), "unknown setting 'squid'; there are: game, variant"),
        (lambda: Config(game=replace(MAZE, name="mine")), "must be registered first"),
        (lambda: Config(variant=replace(CORNER, shifted=MAZE.variants["region-3"])),
         "a variant must be one of maze, but for its knobs"),
        (lambda: Config(variant="corner-small", validation=SMALL.with_knobs({"time_limit": 9})),
         "other knobs than the training's"),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_explained(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_games_and_variants_are_taken_for_their_names():
    mine = MAZE.variants["corner-small"].with_knobs({"largest": 5, "time_limit": 20})
    there = SMALL.with_knobs({"largest": 5, "time_limit": 20})
    config = Config(game=MAZE, variant=mine, validation=there)
    assert config == Config(
        variant="corner-small", validation="anywhere-small", knobs={"largest": 5, "time_limit": 20}
    )
    assert config.training_variant() == mine and Config.from_json(config.to_json()) == config


def test_numbers_of_numpy_are_the_numbers_that_they_are():
    given = {"levels": 1000, "gamma": 0.5, "anneal": False}
    numpys = {"levels": np.int64(1000), "gamma": np.float32(0.5), "anneal": np.bool_(False)}
    one = Config("maze", "anywhere-small", {"time_limit": 9}, **given, sampler=Sampling(buffer=9))
    sampler, knobs = Sampling(buffer=np.int8(9)), {"time_limit": np.int32(9)}
    for variant in (replace(SMALL, time_limit=np.int64(9)), "anywhere-small"):
        two = Config("maze", variant, knobs, **numpys, sampler=sampler)
        assert json.dumps(two.to_json()) == json.dumps(one.to_json()) and repr(two) == repr(one)
    assert repr(Config(WORLD, "end", {"vector": np.float64(1)}).knobs) == "{'vector': 1.0}"


def test_a_shift_and_a_variant_of_your_own_are_played_as_those_with_names():
    named = MAZE.shifts["corner-small"]
    mine = Shift(named.train, named.test, named.intended, named.proxies)
    by_name, _ = evaluate_policies([], "maze", "corner-small", range(20))
    by_shift, _ = evaluate_policies([], MAZE, mine, range(20))
    assert by_name.equals(by_shift)
    variant = replace(MAZE.variants["anywhere-small"], about="mine")
    other, _ = evaluate_policies([], MAZE, mine, range(20), variant=variant)
    assert other["variant"].unique().to_list() == ["mine"]
    assert other.drop("variant").equals(by_name.drop("variant"))
    other = Shift(named.train, named.test, "corner", ("cheese",))
    swapped, _ = evaluate_policies([], MAZE, other, range(20))
    walks = {"policy": "walk to corner", "outcome": "intended goal"}
    rates = [t.filter(**walks, levels_played="distinguishing")["mean"] for t in (swapped, by_name)]
    assert [rate.item() for rate in rates] == [1, 0]


def test_a_test_of_an_experiment_takes_a_variant_of_your_own():
    variant = MAZE.variants["anywhere-small"].with_knobs({"largest": 5})
    test = spec.Test(variant, MAZE.shifts["corner-small"])
    assert test.variant_for(Config(variant="corner-small", knobs={"time_limit": 9})) == variant
    assert test.name == variant.about


def test_knobs_of_the_training_that_the_test_does_not_have_are_said():
    config = Config(variant="region-3", knobs={"region": 4, "time_limit": 50})
    with pytest.warns(LeftOut, match="anywhere is played with region=1: .* region=4 are"):
        assert config.played_variant("anywhere").time_limit == 50
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        config.played_variant("region-3")
        assert config.played_variant("region-2", {"region": 2}).region == 2
