"""What tests and studies share: rows of effects. Not installed."""
