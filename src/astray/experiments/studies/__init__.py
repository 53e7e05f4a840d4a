"""One file for each figure or table; its `EXPERIMENT` defines training, evaluation and display."""
