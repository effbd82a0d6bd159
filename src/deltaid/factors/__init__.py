"""What a recording says as a small file: gathered once where the recording lies, then merged."""
