"""Rigid transforms, wrenches and convex shapes."""
