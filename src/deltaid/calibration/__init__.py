"""Geometric calibration from measured poses, and which dimensions the measurements determine."""
