"""The hard cases: one list, run by `python -m torchbeam hardcases` and by the tests."""
