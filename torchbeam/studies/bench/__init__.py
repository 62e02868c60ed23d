"""Benchmark of the compiled engine: `python -m torchbeam bench`."""
