"""Interpretability studies: published results, repeated on available agents."""
