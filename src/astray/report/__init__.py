"""Claims and charts, for the studies that make them."""
