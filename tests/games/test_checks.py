"""What `astray.testing` tells of a game beside what it checks."""

import logging

import pytest

from astray import games, testing


def test_how_long_a_game_compiles_is_logged_and_many_seconds_are_warned_of(monkeypatch, caplog):
    monkeypatch.setattr(testing, "compiled_loop", lambda game: sum(range(3_000_000)))
    with caplog.at_level(logging.INFO, "astray"):
        testing.check_game(games.find("maze"), variants=[])
    assert caplog.messages == [
        f"maze: compiled, or taken from the cache, in {caplog.records[0].args[1]:.1f} s"
    ]  # pyright: ignore
    monkeypatch.setattr(testing, "SLOW", 0)
    with pytest.warns(
        UserWarning, match=r"maze took \d+ s to compile, more than 0: docs/extending"
    ):
        testing.check_game(games.find("maze"), variants=[])
