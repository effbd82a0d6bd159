"""What robots of one type have in common: the type's mean, spreads between robots, who belongs."""
