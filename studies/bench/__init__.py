"""Benchmark of the compiled engine: `python -m studies bench`."""
