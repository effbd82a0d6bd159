"""A robot with parameters, and the record of their identification."""
