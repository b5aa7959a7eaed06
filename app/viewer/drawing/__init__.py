"""What stands in a 3D scene: cell, bodies, forces, ghosts, signs, and from where it is looked at."""
