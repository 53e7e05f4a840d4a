"""How fast the environments and the training are, beside libraries that do the same."""
