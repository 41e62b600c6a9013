"""Non-linear programming by interior point."""
