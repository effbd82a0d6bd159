"""Descriptions from a few numbers: questions, assumptions, and how to find out the numbers."""
