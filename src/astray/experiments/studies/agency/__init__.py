"""The study of the agency measure itself."""
