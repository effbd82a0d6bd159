"""deltaid: dynamic models of Delta-like robots, identified from recordings."""
