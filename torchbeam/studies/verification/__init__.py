"""Verification against closed forms, published figures and other codes; run by
`python -m torchbeam verify` and the tests.
"""
