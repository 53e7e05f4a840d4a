"""Experiments: train and play what a figure or table needs, and report it."""
