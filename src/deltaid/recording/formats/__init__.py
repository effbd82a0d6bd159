"""Kinds of files, one module each, which `deltaid.recording.table.FORMATS` lists."""
