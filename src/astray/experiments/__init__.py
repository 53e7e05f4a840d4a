"""Experiments: what is trained and played for a figure or table, run, and reported."""
