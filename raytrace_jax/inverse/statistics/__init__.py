"""What residuals tell: how sure unknowns are, and whether a picture explains its target; for solver and judge."""
