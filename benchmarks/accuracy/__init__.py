"""Errors of fitted models over random draws, compared with the errors that the models predict."""
