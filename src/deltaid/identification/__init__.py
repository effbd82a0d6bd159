"""From samples to parameters: information, base parameters, the consistent fit, uncertainty."""
