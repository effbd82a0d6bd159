"""Verdicts on units and wiring: what the columns of a log are, and of which drive."""
