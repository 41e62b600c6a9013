"""The sample corpus: yards, the planner that drives through them, and the logs that are written of it."""
