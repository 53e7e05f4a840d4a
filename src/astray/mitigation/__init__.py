"""What helps against unintended goals: uncertainty, help that is asked for, other hypotheses."""
