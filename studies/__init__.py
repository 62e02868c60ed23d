"""Measurements of the library, each a command that `python -m studies` lists."""
