"""What agents do: episodes as tables, outcomes, intervals."""
