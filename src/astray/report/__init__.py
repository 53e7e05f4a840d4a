"""Claims about what was measured, below the studies that make them."""
