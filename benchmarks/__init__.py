"""How fast environments and training are, beside libraries that do the same; what eyes learn."""
