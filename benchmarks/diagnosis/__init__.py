"""Diagnoses of sessions in which the truth is known: right, wrong, and how sure they were."""
