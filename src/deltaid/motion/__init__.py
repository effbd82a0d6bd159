"""Motions in task coordinates, random motions within a robot's limits, simulated recordings."""
