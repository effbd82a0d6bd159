"""Pages of the studio: a frame, and one module a stage."""
