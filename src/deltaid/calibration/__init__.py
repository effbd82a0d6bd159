"""The geometry of a robot from what people measure, and which of its numbers that can know."""
