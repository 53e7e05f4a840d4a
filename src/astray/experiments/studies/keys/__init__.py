"""The study of thieves with keys and chests."""
