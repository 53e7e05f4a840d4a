"""Looking into agents: what others found in theirs, on those at hand."""
