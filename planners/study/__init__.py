"""Studies: how a task fares at many values of up to two of its members."""
