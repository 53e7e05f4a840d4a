"""Tests of tomato watering."""
