"""What an identified model is for: forward dynamics, simulation, controllers."""
