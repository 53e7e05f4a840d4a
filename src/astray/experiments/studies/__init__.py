"""One file for each figure or table; `EXPERIMENT` in it says what to train, evaluate and show."""
