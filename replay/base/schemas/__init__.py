"""Schemas of the files that other programs read or write: one module for each document, plain data only."""
