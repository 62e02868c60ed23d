"""Learners for the environments, one file an algorithm; run from the top of the repository:
`python -m training.ppo --help`.
"""
