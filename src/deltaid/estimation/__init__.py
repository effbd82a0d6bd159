"""Linear least squares as a value: columns, rows in groups, what is known before."""
