"""The description a user writes, the shipped catalogue, and priors from shapes."""
