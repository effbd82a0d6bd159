"""Values as text, cards, figures, tables and pages, for the terminal, notebooks and studio."""
