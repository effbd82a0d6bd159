"""Rows of additional sensors and measured values, and plans of which ones to buy."""
