"""Identification: parameters, measurements, the fit, what it does not tell, and its uncertainty."""
