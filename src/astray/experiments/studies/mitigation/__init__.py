"""Studies of what keeps agents from the wrong goal."""
