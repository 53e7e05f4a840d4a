"""The study of the pottery shop."""
