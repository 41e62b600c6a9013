"""The exact local planner: steering between two full states without a map."""
