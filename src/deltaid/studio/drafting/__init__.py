"""A description written from a few numbers: what is asked, what is assumed, how to find it out."""
