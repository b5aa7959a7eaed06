"""Kinematics of the arms: forward, all branches of the inverse, and whole turns of the joints."""
