"""A robot with its parameters, and the record of the identification behind them."""
