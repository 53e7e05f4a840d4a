"""Interpretability: activations, interventions, fields, vectors, probes, attribution."""
