"""The hard cases: one list, run by `python -m studies hardcases` and by the tests."""
