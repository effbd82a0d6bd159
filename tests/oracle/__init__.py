"""Independent references for the tests; nothing here may import the package under test."""
