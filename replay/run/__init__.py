"""Runs: cases, judged results, their files."""
