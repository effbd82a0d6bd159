"""Friction over weeks and months: what changes, since when, how fast, and until when."""
