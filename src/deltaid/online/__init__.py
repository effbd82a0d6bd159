"""Payload, contact and friction while the robot runs: one cycle as one graph, in bounded time."""
