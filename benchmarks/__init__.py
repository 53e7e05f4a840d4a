"""Speed of environments and training, beside libraries that do the same; what eyes learn."""
