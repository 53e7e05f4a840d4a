"""Pictures that games draw with: `own`, made here, and `original`, which the user imports."""
