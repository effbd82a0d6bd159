"""Reads logs: columns and units, checks, filtering and differentiation, windows of samples."""
