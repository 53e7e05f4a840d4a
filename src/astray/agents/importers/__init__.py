"""Importers of published agents, which execute nothing in their files."""
