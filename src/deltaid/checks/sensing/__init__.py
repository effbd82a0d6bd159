"""Sensor signals compared with the robot as torques determine it."""
