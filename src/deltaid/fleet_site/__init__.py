"""The static site of a fleet, from its tables: an overview, a page a robot, a page a type."""

from deltaid.fleet_site.site import write

__all__ = ["write"]
