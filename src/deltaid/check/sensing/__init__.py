"""What a robot's sensors show against what torques say of it."""
