"""The report of a fit as a page, a figure and JSON."""
