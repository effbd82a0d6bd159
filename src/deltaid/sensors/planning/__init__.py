"""Which measurement is worth its price: what torques leave open, and what would close it."""
