"""What helps against goals that are not meant: doubts, help that is asked for, other hypotheses."""
