"""The study of training curves."""
