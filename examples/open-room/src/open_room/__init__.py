"""A game, a network, a loss and an experiment of one's own."""
