"""Verdicts on units and wiring: quantity, unit and drive of a log's columns."""
