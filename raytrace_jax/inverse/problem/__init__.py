"""What is fitted: unknowns, target, residual and its derivative."""
