"""Studies of what the network, and who teaches it, have to do with the goal."""
