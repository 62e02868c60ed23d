"""Verification against closed forms, published figures and other codes; run by
`python -m studies verify` and the tests.
"""
