"""Motions in task coordinates, random ones within a robot's limits, and simulated recordings."""
