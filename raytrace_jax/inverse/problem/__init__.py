"""The problem of a fit: what is free, what was observed, and the residual between them."""
