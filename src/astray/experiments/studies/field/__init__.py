"""Studies of other publications' worlds."""
