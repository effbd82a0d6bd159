"""The time of a recording: stamps, holes, segments, and channels with clocks of their own."""
