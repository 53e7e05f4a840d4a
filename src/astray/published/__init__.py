"""Agents that others published: where they are, and how they are read, checked and kept."""
