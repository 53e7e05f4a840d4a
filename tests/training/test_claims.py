"""What a run's folder may hold before a training begins in it."""

from dataclasses import replace

import pytest

from astray.files import aside_of
from astray.training import checkpoint
from astray.training.log import read_metrics
from astray.training.loop import train
from helpers.trainings import TINY


@pytest.mark.parametrize("name", ["config.json", "metrics.jsonl"])
@pytest.mark.parametrize("target", ["mine.txt", "nowhere", "itself"])
def test_a_link_in_the_place_of_a_runs_file_stays(tmp_path, name, target):
    run = tmp_path / "run"
    run.mkdir()
    (tmp_path / "mine.txt").write_text("mine")
    link = run / name
    link.symlink_to(link if target == "itself" else tmp_path / target)
    with pytest.raises(OSError, match=f"{name} must be a file to write; it is a link"):
        train(TINY, run, progress=False)
    assert link.is_symlink() and (tmp_path / "mine.txt").read_text() == "mine"


def test_no_validation_is_another_than_one_without_a_name():
    with pytest.raises(ValueError, match="unknown variant ''"):
        replace(TINY, validation="")


@pytest.mark.parametrize("name", ["config.json", "metrics.jsonl"])
def test_what_a_kill_left_of_a_runs_files_is_removed(tmp_path, name):
    left, mine = aside_of(tmp_path / name), tmp_path / f".{name}.mine"
    for path in (left, mine):
        path.write_text("half of")
    with checkpoint.claim(tmp_path, TINY):
        assert not left.exists() and mine.exists()


@pytest.mark.parametrize("text", ["mine", "[", '{"name": 1', "\x1e\n"])
def test_what_no_training_wrote_is_not_taken_for_half_a_line(tmp_path, text):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"steps": 1}\n' + text)
    with pytest.raises(ValueError, match=r"metrics.jsonl, line 2: a training did not write it"):
        list(read_metrics(path))


@pytest.mark.parametrize("cut", ["", "{", '{"ste', '{"steps": ', '{"steps": 2, "training/re'])
def test_half_a_line_that_a_kill_left_is_left_out(tmp_path, cut):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"steps": 1}\n' + cut)
    assert [data["steps"] for _, data in read_metrics(path)] == [1]
