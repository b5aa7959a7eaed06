"""A stand-in for the controller of a robot arm: what the tests run emitted programs on, and connect `ur-rtde` to.

It speaks what Universal Robots publish: RTDE version 2 on port 30004, the dashboard on 29999, scripts on 30002. An arm
has a process, one loop, one tick a control cycle. It knows nothing of planners: an arm is joints, limits and axes.
What is not modelled is said where it is left out: the lag of `servoj` and the arm's dynamics.
"""
