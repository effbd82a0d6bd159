"""Robot descriptions, the catalogue that ships with the package, and priors from shapes."""
