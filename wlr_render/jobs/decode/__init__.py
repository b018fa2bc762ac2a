"""`decode`: read photographs of a panel or projector that shows a code."""
