"""Presentation of values as text, cards, figures, tables and pages, for the terminal, notebooks and
the studio."""
