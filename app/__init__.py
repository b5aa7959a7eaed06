"""The service: HTTP, command line, demo. Knows workers and planners; neither knows it."""
