"""What of a recording is no motion under power of the drives, and is left out."""
