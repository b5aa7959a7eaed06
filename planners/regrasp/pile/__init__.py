"""Object after object: the order of a pile, stopovers, and the plan of one object."""
