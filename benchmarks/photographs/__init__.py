"""Benchmark of reading simulated photographs: codes, boards, whole sessions."""
