"""Kinds of files, one module each, listed in `deltaid.recording.table.FORMATS`."""
