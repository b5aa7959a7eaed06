"""Compiled, conservative collision queries over convex shapes."""
