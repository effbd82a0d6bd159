"""Time of a recording: stamps, holes, segments, and channels with different clocks."""
