"""Optimised motions that make the parameters visible and keep the machine within its limits."""
