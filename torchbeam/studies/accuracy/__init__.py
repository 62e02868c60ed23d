"""Work-precision: which setting is cheapest for an error, over motions, elements and methods."""
