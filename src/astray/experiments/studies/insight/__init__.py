"""Studies of what is inside of agents."""
