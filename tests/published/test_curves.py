"""Published training curves, beside those of a run."""

import json
from dataclasses import replace

import pytest

from astray.experiments.outcomes import curve_plot
from astray.published.curves import beside, curves
from astray.training.config import PRESETS
from astray.training.folders import CONFIG
from astray.training.log import METRICS

RUNNER = replace(PRESETS["night"], game="coinrun", variant="coin-end", validation="coin-anywhere")


def test_every_published_curve_has_a_value_for_each_bin_and_a_source():
    ends = curves()["ends"]
    assert ends == sorted(ends) and ends[-1] == 200
    for one in curves()["curves"]:
        assert len(one["returns"]) == len(ends) and "commit" in one["source"]
        assert min(one["returns"]) >= 0 and max(one["returns"]) <= 10


@pytest.mark.parametrize(
    "config, steps, points",
    [
        (RUNNER, 2_000_000, 2 * 3),  # two runs were published; up to 3 million steps
        (RUNNER, 200_000_000, 2 * 20),
        (replace(RUNNER, game="maze", variant="corner", validation=None), 2_000_000, 3),
        (replace(RUNNER, variant="coin-end-calm"), 2_000_000, 0),
        (replace(RUNNER, knobs={"hazards": False}), 2_000_000, 0),
    ],
)
def test_only_trainings_in_the_papers_worlds_have_published_curves(config, steps, points):
    found = beside(config, steps)
    assert len(found) == points
    assert not points or found["steps"].max() <= 1.5 * steps


def test_a_run_is_drawn_beside_the_published_curves_of_its_world(tmp_path):
    run = tmp_path / "seed-0"
    run.mkdir()
    config = replace(RUNNER, validation_every=1)
    (run / CONFIG).write_text(json.dumps({"config": config.to_json()}))
    lines = [
        {"steps": k * 1_000_000, "training/return": 5.0 + k, "validation/return": 1.0 + k}
        for k in (1, 2)
    ]
    (run / METRICS).write_text("".join(json.dumps(line) + "\n" for line in lines))
    plot = curve_plot({"runner": [run]})
    (axes,) = plot.figure.axes
    lines = {line.get_label(): line for line in axes.lines}
    for one in curves()["curves"]:
        assert (one["name"] in lines) == (one["game"] == "coinrun")
    first = lines["the paper's program, seed 6033"]
    assert lines["validation variant"].get_ydata().tolist() == [2, 3]  # which may be no test
    assert first.get_linestyle() == "--" and lines["training variant"].get_linestyle() == "-"
    assert first.get_xdata().tolist() == [0.5, 1.5, 2.5]
    assert first.get_ydata().tolist() == [4.47, 5.12, 5.47]
    assert "public logs" in plot.caption
