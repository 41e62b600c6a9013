"""Paths at knots: transcription, rounds, motion between knots."""
