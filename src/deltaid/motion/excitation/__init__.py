"""Optimised motions that make parameters identifiable within the limits of the machine."""
