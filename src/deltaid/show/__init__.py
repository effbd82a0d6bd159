"""A robot to look at: what it can reach, as a page, and a live view to drag it about."""
