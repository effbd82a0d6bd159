"""The static site of a fleet, from its tables: an overview, and a page for each robot and type."""
