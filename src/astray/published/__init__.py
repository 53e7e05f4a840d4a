"""Published agents of others: their addresses, import, checks and storage."""
