"""Tests of the game; a package, so that two games may name their tests alike."""
