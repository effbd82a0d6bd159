"""Rows of a recording that are excluded because drives do not power the motion there."""
