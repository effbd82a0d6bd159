"""Descriptions from a few numbers: questions, assumptions, and where to find the numbers."""
