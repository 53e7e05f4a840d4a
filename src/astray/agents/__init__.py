"""Networks and policies on observations and action counts; nothing here depends on games."""
