"""Studies of uncertainty: what samples cost, and how often intervals hold."""
