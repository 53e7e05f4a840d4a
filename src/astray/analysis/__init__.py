"""Behaviour of agents: episodes as tables, outcomes, intervals."""
