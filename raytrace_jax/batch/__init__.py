"""Many renders, derivatives and fits by one plan file: what to do, doing it here or on a cluster, and the table."""
