"""Linear least squares as a value: columns, rows in groups, priors; solvers and intervals."""
