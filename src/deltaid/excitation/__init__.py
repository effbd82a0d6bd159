"""Motions that make the parameters visible."""
