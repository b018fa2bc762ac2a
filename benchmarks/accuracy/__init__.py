"""Errors of fitted models over random draws, beside what the models predict of themselves."""
