"""Posterior of the parameters, and what follows for predictions."""
