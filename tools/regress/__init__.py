"""Regression runs under load: thousands of small logs, killed workers, killed coordinators."""
