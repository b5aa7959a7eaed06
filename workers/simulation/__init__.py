"""A plan executed in physics, and the cooperative lift that follows it."""
