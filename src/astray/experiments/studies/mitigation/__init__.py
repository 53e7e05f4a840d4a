"""Studies of mitigations of goal misgeneralization."""
