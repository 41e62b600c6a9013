"""Spoiling sound claims, to see that the audit notices."""
