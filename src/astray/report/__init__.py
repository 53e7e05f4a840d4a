"""Claims about results, for the studies that make them."""
