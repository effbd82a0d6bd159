"""How values show themselves at a prompt and in a notebook; one module a kind of value."""
