"""Networks and PPO: pure functions of tensors, which know images and action counts, not games."""
