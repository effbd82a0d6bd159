"""What a controller makes of a model: control laws on a sampled drive, simulation, comparison."""
