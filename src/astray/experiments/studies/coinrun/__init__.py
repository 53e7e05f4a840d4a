"""Studies of runners in CoinRun."""
