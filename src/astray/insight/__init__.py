"""Looking inside agents: activations, interventions, fields, vectors, probes, attribution."""
