"""What a run found, as one HTML page that works offline."""
