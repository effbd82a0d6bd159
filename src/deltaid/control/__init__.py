"""Control laws on sampled drives, their simulation, and the comparison of models."""
