"""Runs jobs: the engine, the solver processes, the store of plans. Knows the planners, knows nothing of HTTP."""
