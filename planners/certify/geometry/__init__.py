"""Shapes of bodies, without motion: convex parts, surfaces, and what covers what."""
