"""Attacks on the program: what must hold whatever happens is tried, many times; each is a module of its own."""
