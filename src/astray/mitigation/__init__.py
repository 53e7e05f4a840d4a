"""Mitigations of goal misgeneralization: uncertainty, asking for help, diverse hypotheses."""
