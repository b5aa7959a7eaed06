"""Suction: where a pad seals on an object, what a cup holds, and the poses of the tool that follow."""
