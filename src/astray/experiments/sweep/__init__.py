"""Sweeps: agents for every combination of some settings, and their goals."""
