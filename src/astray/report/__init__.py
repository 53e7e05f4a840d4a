"""What is reported of what was measured: claims, below the studies that make them."""
