"""Compiled building blocks that the games share."""
