"""Tests of the boat race."""
