"""The static site of a fleet, from its tables: an overview, a page a robot, a page a type."""
