"""The study of what trainings measured."""
