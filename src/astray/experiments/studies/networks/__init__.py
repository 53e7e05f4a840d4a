"""Studies of the effect of the network and of its teacher on the goal."""
