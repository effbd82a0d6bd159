"""What a recording says, kept as a small file: gathered once where the recording lies, then merged."""
