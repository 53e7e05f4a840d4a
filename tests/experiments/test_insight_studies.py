"""Studies that look into agents run whole on the pretrained ones, in miniature."""

import json
from dataclasses import replace

import polars as pl
import pytest

from astray.estimate import Estimate
from astray.experiments import catalogue, run
from astray.experiments.studies.insight import choice, decodable, retargeting
from astray.experiments.studies.insight._plans import of_levels
from astray.insight.retarget import AS_IS, MOVED
from astray.report.claims import Claim, above, below, within
from helpers import registered
from helpers.thorough import thorough

LEVELS = {"cheese-vector": 6, "retargeting": 18, "decodable": 24, "choice": 1500}


# The others add vectors, and fit probes and predictions, which `tests/insight` does, too.
@pytest.mark.parametrize("name", ["retargeting", *thorough("cheese-vector", "decodable", "choice")])
def test_studies_of_kept_agents_run_in_miniature(name, tmp_path, monkeypatch):
    # The first layer has thirty times as many numbers as the others, and needs as much longer.
    monkeypatch.setitem(decodable.LAYERS, "smoke", decodable.LAYERS["smoke"][1:])
    monkeypatch.setitem(decodable.FOLDS, "smoke", 2)  # for each of which all probes are fitted
    monkeypatch.setattr(retargeting, "LEARN", 10)
    monkeypatch.setattr(retargeting, "TUNE", 2)
    whole = catalogue.load(name)
    small = replace(whole, sizes={"smoke": replace(whole.sizes["smoke"], levels=LEVELS[name])})
    page = run.reproduce(small, "smoke", tmp_path)
    found = json.loads((page.parent / "findings.json").read_text())
    claims = found["claims"]
    assert claims and all(
        "; supported if " in one["ours"] and "; p = " in one["ours"] for one in claims
    )
    told = [Claim(**{k: one[k] for k in one if k != "beside"}) for one in claims]
    assert not registered.unstated(name, told)
    assert "nan" not in found["answer"], found["answer"]
    figures = {path.stem for path in (page.parent / "figures").iterdir()}
    assert figures and (page.parent / "figures" / f"{min(figures)}.png").stat().st_size > 5000
    assert not list(tmp_path.glob("agents/*")), "nothing is trained"


def test_a_claim_is_supported_only_where_its_whole_interval_does():
    low = within("c", "p", "w", estimate(0.2, 0.3), (0.1, 0.25))
    high = within("c", "p", "w", estimate(0.2, 0.3), (0.1, 0.35))
    assert (low.supported, high.supported) == (False, True)
    assert "between 10\xa0% and 35\xa0%" in high.ours
    assert above("c", "p", "w", estimate(0.2, 0.3), 0.1).ours.endswith("above 10\u00a0%")
    assert below("c", "p", "w", estimate(0.2, 0.3), 0.1).supported is False


def estimate(low, high):
    return Estimate((low + high) / 2, low, high, 1, 10, 10)


def test_differences_are_of_the_same_levels():
    rows = pl.DataFrame({
        "level": [0, 1, 2, 0, 2], "condition": ["a", "a", "a", "b", "b"],
        "at": [0.5, 0.9, None, 0.1, 0.3],
    })  # fmt: skip
    assert of_levels(rows, "at", "a").mean == pytest.approx(0.7)
    assert of_levels(rows, "at", "a", minus="b").mean == pytest.approx(0.4)
    assert of_levels(rows, "at", "a", minus="b").levels == 1


def test_paths_are_means_of_levels_not_of_targets():
    rows = pl.DataFrame({
        "level": [0, 0, 0, 1] * 2, "how": [AS_IS] * 4 + [MOVED] * 4,
        "path": [0.1, 0.1, 0.1, 0.5, 0.3, 0.3, 0.3, 0.9],
    })  # fmt: skip
    assert retargeting.of_levels(rows, AS_IS).mean == pytest.approx(0.3)
    assert retargeting.of_levels(rows, MOVED, AS_IS).mean == pytest.approx(0.3)


def test_the_published_features_are_ones_that_mazes_have():
    table = choice.level_features("maze", "anywhere-easy", range(3))
    assert set(choice.PUBLISHED) <= set(table.columns)
