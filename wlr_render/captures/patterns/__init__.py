"""Codes shown on a panel and their decoding; `catalogue` lists them."""
