"""Presentation of values as text, cards, figures, tables and pages, for terminal, notebooks and
studio."""
