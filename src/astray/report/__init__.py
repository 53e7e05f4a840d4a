"""Claims, findings and pages, for the studies that make them."""
