"""Dynamics from one symbolic source: regressor, M, C, g and f, evaluated in batches."""
