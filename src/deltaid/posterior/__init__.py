"""Consistent models drawn from what data, prior and physical consistency say together."""
