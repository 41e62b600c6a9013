"""Meaning of messages: from decoded messages to cases."""
