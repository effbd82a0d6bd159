"""What the studio shows: a frame, and one module a stage."""
