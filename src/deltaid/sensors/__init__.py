"""Rows beside the drives' torques: what other sensors show, and which ones are worth buying."""
