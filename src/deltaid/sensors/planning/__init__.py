"""Plans of measurements: what torques do not determine, and which measurement is worth its
price."""
