"""Sweeps: agents of every combination of some settings, and what each of them pursues."""
