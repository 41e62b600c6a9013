"""Non-linear optimisation by an interior point method: symbolic model, collision duals, the solver's words."""
