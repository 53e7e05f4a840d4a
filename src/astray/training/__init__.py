"""Training agents: `config`, then `loop`, then what they call."""
