"""Physical causes of differences between recordings and the rigid robot, each in a file."""
