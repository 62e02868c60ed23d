"""Analyses of scenes: identification, uncertainty, advice on modelling, description."""
