"""Dynamics from one symbolic source: regressor, M, C, g, f, and their evaluation in batches."""
