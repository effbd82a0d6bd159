"""Verdicts on a description, a recording and its fit, each with its number, cause and cure."""
