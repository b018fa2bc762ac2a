"""Predicted covariance of registration against true errors of simulated sessions."""
