"""Pictures of games: `own` ones in this package, and `original` ones that the user imports."""
